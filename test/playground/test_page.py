"""The page in a real browser, with a real planner and a simulated arm behind it."""

from __future__ import annotations

from collections import deque
from contextlib import contextmanager
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import time

from chromium import browser, Chromium
from conftest import make_panda, PANDA_URDF
from live_helpers import children_of, PATIENCE, station
import numpy as np
import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from ros_domains import next_domain
from sensor_msgs.msg import JointState
from visualization_msgs.msg import MarkerArray

from redundant_planner.nodes.polled_subscription import PolledSubscription
from redundant_planner.playground.drive_controls import HANDLE_SIZE
from redundant_planner.playground.scenes import page_scenes
from redundant_planner.playground.world import MOST_ITEMS

# A browser that draws in software beside other work may take longer than any patience: each is
# tried three times.
IN_BROWSER = pytest.mark.flaky(reruns=2, reruns_delay=1)
pytestmark = [pytest.mark.live, pytest.mark.skipif(
    browser() is None, reason='no Chromium on this machine (apt install chromium)')]
PANDA = make_panda()
# The end of all processes takes no longer, on a busy machine too [s].
END = 20.0
# Screenshots stay here, for those who want to see what the browser saw.
PICTURES = Path(os.environ.get('PLAYGROUND_PICTURES', 'build/playground'))
TOKEN = "document.querySelector('[data-playground-token]')"
FIGURES = "document.querySelector('[data-figures]')"
# Pixels that are not the background, in what WebGL has drawn.
DRAWN = """(() => {
    const canvas = document.querySelector('canvas');
    if (!canvas?.width) return Promise.resolve(0);
    const small = document.createElement('canvas');
    small.width = small.height = 64;
    return new Promise((answer) => requestAnimationFrame(() => {
        const context = small.getContext('2d');
        context.drawImage(canvas, 0, 0, 64, 64);
        const data = context.getImageData(0, 0, 64, 64).data;
        const colours = new Set();
        for (let i = 0; i < data.length; i += 4)
            colours.add(data[i] * 65536 + data[i + 1] * 256 + data[i + 2]);
        answer(colours.size);
    }));
})()"""


class Arm:
    """What ROS says of the arm behind the page.

    Messages are fetched when they are wanted: a callback for each would fall behind while a
    browser is waited for, and tell of what was long ago.
    """

    def __init__(self, domain):
        self.domain, self._context = domain, Context()
        rclpy.init(context=self._context, domain_id=domain)
        self._node = Node('onlooker', context=self._context)
        self._inboxes, self._markers = {}, {}

    def messages(self, kind, topic, depth=50):
        """Return the messages on a topic since the last call, as far as they were kept."""
        if topic not in self._inboxes:
            self._inboxes[topic] = PolledSubscription(
                self._node, kind, topic, QoSProfile(depth=depth))
        return [deserialize_message(raw, kind) for raw in self._inboxes[topic].fetch()]

    @property
    def markers(self):
        """Obstacles by their names."""
        for message in self.messages(MarkerArray, 'obstacles', 1000):
            for marker in message.markers:
                if marker.action == marker.ADD:
                    self._markers[marker.ns] = marker
                else:
                    self._markers.pop(marker.ns, None)
        return self._markers

    def posture_of(self, topic):
        """Return how the Panda behind a topic stands now."""
        self.messages(JointState, topic)
        states = []
        self.wait_for(lambda: states.extend(self.messages(JointState, topic)) or states, topic)
        message = states[-1]
        return PANDA.kinematics([message.position[message.name.index(name)]
                                 for name in PANDA.joint_names])

    def tip_of(self, topic):
        """Return where the tip of the Panda behind a topic is now."""
        return self.posture_of(topic).tip_position

    @property
    def tip(self):
        return self.tip_of('joint_states')

    def is_commanded(self):
        return bool(self.messages(JointState, 'joint_command'))

    def comes_to_rest(self):
        """Wait until 20 commands in turn are stops."""
        last = deque(maxlen=20)

        def rests():
            last.extend(np.any(m.velocity) for m in self.messages(JointState, 'joint_command'))
            return len(last) == 20 and not any(last)

        self.messages(JointState, 'joint_command')
        self.wait_for(rests, 'rest')

    @staticmethod
    def wait_for(condition, what):
        """Wait until something is so."""
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline, f'waited {PATIENCE} s in vain: {what}'
            time.sleep(0.02)

    def close(self):
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)


@contextmanager
def playground(folder):
    """Yield the arm and the address of a page with that arm behind it."""
    arm, log = Arm(next_domain()), folder / 'log'
    environment = dict(os.environ, PLAYGROUND_TEST=str(folder), ROS_DOMAIN_ID=str(arm.domain))
    with log.open('w') as output:
        process = subprocess.Popen(
            [sys.executable, '-m', 'redundant_planner.tools.playground', '--port', '0',
             '--recordings', str(folder / 'recordings')],
            env=environment, stdout=output, stderr=output, start_new_session=True)

    def address():
        assert process.poll() is None, log.read_text()
        return re.search(r'open (http://\S+)', log.read_text())

    try:
        arm.wait_for(lambda: address() and arm.is_commanded(), 'the page and the arm')
        assert len(re.findall('http://', log.read_text())) == 1, 'more than one address'
        yield arm, address().group(1)
        process.send_signal(signal.SIGINT)
        begin = time.monotonic()
        assert process.wait(PATIENCE) == 0, log.read_text()
        assert time.monotonic() - begin < END
        assert not children_of(f'PLAYGROUND_TEST={folder}'), 'an orphan'
        assert 'Traceback' not in log.read_text(), log.read_text()
    finally:
        process.kill()
        process.wait()
        arm.close()


def picture(page, name):
    PICTURES.mkdir(parents=True, exist_ok=True)
    page.picture(PICTURES / f'{name}.png')


def ready(page):
    """Wait until a page shows a living arm and may drive it."""
    page.wait_for(f'{TOKEN} && {FIGURES} && {FIGURES}.innerText.includes("nearest")')


def hold(arm, page, key, condition, what):
    """Hold a key until something is so."""
    page.key(key, down=True)
    try:
        arm.wait_for(condition, what)
    finally:
        page.key(key, down=False)


@pytest.mark.long
@IN_BROWSER
def test_a_key_moves_the_arm_its_release_stops_it_and_so_does_a_closed_page(tmp_path):
    with playground(tmp_path) as (arm, url), Chromium() as chromium:
        page = chromium.open(url)
        ready(page)
        page.wait_for(f'{DRAWN}.then((colours) => colours > 20)')
        begin = arm.tip
        hold(arm, page, 'KeyQ', lambda: arm.tip[2] > begin[2] + 0.03, 'motion up')
        arm.comes_to_rest()
        there = arm.tip
        assert there[2] > begin[2] + 0.03
        np.testing.assert_allclose(there[:2], begin[:2], atol=5e-3)
        # A key that is held while another window comes up.
        page.key('KeyE', down=True)
        arm.wait_for(lambda: arm.tip[2] < there[2] - 0.01, 'motion down')
        page.value("window.dispatchEvent(new Event('blur'))")
        arm.comes_to_rest()
        page.key('KeyE', down=False)

        watcher = chromium.open(url)
        watcher.wait_for("document.body?.innerText.includes('Somebody else drives')")
        assert not watcher.value(f'!!{TOKEN}')
        before = arm.tip
        watcher.key('KeyQ', down=True)
        watcher.value('new Promise((done) => setTimeout(done, 1500))')
        watcher.key('KeyQ', down=False)
        np.testing.assert_allclose(arm.tip, before, atol=1e-3)

        picture(page, 'page')
        # Closed in motion; then the other one may drive.
        page.call('Page.bringToFront')
        page.key('KeyE', down=True)
        arm.wait_for(lambda: arm.tip[2] < before[2] - 0.01, 'motion down')
        assert not page.errors
        page.close()
        arm.comes_to_rest()
        watcher.call('Page.bringToFront')
        ready(watcher)
        before = arm.tip
        hold(arm, watcher, 'KeyQ', lambda: arm.tip[2] > before[2] + 0.01, 'motion of the next')
        assert not watcher.errors


@pytest.mark.long
@IN_BROWSER
def test_the_button_that_drives_by_sliders_is_held_like_its_key(tmp_path):
    with playground(tmp_path) as (_, url), Chromium() as chromium:
        page = chromium.open(url)
        ready(page)
        page.value("""(() => {
            window.told = [];
            const send = WebSocket.prototype.send;
            WebSocket.prototype.send = function (message) {
                if (typeof message === 'string') window.told.push(JSON.parse(message));
                return send.call(this, message);
            };
        })()""")
        # It is drawn once its folder has been opened.
        page.value("""[...document.querySelectorAll('*')].findLast(
            (one) => one.innerText?.trim() === 'A twist by sliders').click()""")
        button = "document.querySelector('[data-held]')"
        # It has come to rest where it can be pressed.
        middle = f"""(() => {{
            {button}.scrollIntoView({{block: 'center'}});
            const {{x, y, width, height}} = {button}.getBoundingClientRect();
            return [x + width / 2, y + height / 2];
        }})()"""
        page.wait_for(f"""{button} && (() => {{
            const before = window.place;
            window.place = {middle};
            return `${{before}}` === `${{place}}`
                && document.elementFromPoint(...place) === {button};
        }})()""")
        x, y = page.value(middle)
        page.mouse('mouseMoved', x, y)
        page.mouse('mousePressed', x, y, held=True)
        page.wait_for(
            'told.filter((one) => one.keys.includes("Space") && one.clock > 0).length > 5')
        picture(page, 'hold_button')
        page.mouse('mouseReleased', x, y)
        page.wait_for('told.at(-1).keys.length === 0')
        assert not page.errors


@pytest.mark.long
@IN_BROWSER
def test_an_obstacle_that_is_dragged_into_the_way_stops_the_arm(tmp_path):
    with playground(tmp_path) as (arm, url), Chromium() as chromium:
        page = chromium.open(url)
        ready(page)
        arm.wait_for(lambda: len(arm.markers) == len(page_scenes(None)[0].items), 'the scene')
        page.wait_for(f'{DRAWN}.then((colours) => colours > 20)')
        begin = np.array([getattr(arm.markers['ball'].pose.position, c) for c in 'xyz'])
        # Where the page's first camera sees the ball; away from the arm.
        x, y = seen_at(page, begin)
        drag(page, (x, y), (x + 100, y - 80))

        def moved():
            position = arm.markers['ball'].pose.position
            return np.linalg.norm((position.x, position.y, position.z) - begin) > 0.1

        arm.wait_for(moved, 'the ball elsewhere')
        picture(page, 'dragged')
        # Added, chosen and deleted by the panel.
        before = set(arm.markers)
        press(page, '+ box')
        arm.wait_for(lambda: set(arm.markers) - before == {'box 1'}, 'a new box')
        press(page, 'Delete')
        arm.wait_for(lambda: set(arm.markers) == before, 'no new box')
        # A box beside the hand: the arm does not go there, and says why.
        press(page, '+ box')
        arm.wait_for(lambda: 'box 1' in arm.markers, 'a box')
        begin = arm.tip
        page.key('KeyD', down=True)
        page.wait_for(f'{FIGURES}.innerText.includes("box")')
        arm.wait_for(lambda: arm.tip[1] < begin[1] - 0.05, 'motion')
        page.wait_for(f'{FIGURES}.innerText.includes("near obstacle \'box")')
        page.value('new Promise((done) => setTimeout(done, 2000))')
        # Two seconds more would have taken it a foot further, and through the box.
        assert -0.3 < arm.tip[1] < begin[1] - 0.05
        page.key('KeyD', down=False)
        arm.comes_to_rest()
        assert not page.errors


@pytest.mark.long
@IN_BROWSER
def test_the_arm_goes_where_its_handle_is_dragged(tmp_path):
    with playground(tmp_path) as (arm, url), Chromium() as chromium:
        page = chromium.open(url)
        ready(page)
        page.wait_for(f'{DRAWN}.then((colours) => colours > 20)')
        begin = arm.posture_of('joint_states')
        place, along = begin.tip_position, begin.tip_rotation[:, 2]
        # By the arrow that points out of the hand, down: up by twelve centimetres.
        taken = place + 0.8 * HANDLE_SIZE * along
        drag(page, seen_at(page, taken), seen_at(page, taken - 0.12 * along))
        page.wait_for(f'{FIGURES}.innerText.includes("target")')
        arm.wait_for(lambda: arm.tip[2] > place[2] + 0.1, 'motion to the handle')
        arm.comes_to_rest()
        # It goes on to where the handle was left, and stays in its line.
        np.testing.assert_allclose(arm.tip, place - 0.12 * along, atol=0.015)
        picture(page, 'handle')
        assert not page.errors


@pytest.mark.long
@IN_BROWSER
def test_a_page_that_sends_nonsense_and_many_clicks_at_once(tmp_path):
    with playground(tmp_path) as (arm, url), Chromium() as chromium:
        page = chromium.open(url)
        ready(page)
        token = page.value(f'{TOKEN}.dataset.playgroundToken')
        begin = arm.tip
        page.value(f"""new Promise((done) => {{
            const socket = new WebSocket(`ws://${{location.host}}/held?token={token}`);
            socket.onopen = () => {{
                for (const pad of ['{{"axes": [NaN, 1e999], "buttons": [true]}}',
                                   '{{"axes": [1e300, -1e300], "buttons": [0,0,0,0,true]}}',
                                   '[]', '7', '{{"axes": {{}}}}'])
                    socket.send(`{{"clock": 1e9, "keys": [], "pad": ${{pad}}}}`);
                socket.send('x'.repeat(100000));
                setTimeout(done, 1000);
            }};
        }})""")
        ready(page)
        arm.comes_to_rest()
        # One full stroke of a stick at most, for as long as a silent page counts.
        assert np.linalg.norm(arm.tip - begin) < 0.15
        arm.wait_for(lambda: len(arm.markers) == len(page_scenes(None)[0].items), 'the scene')
        before = len(arm.markers)
        # As fast as nobody clicks: a page takes clicks together that come together.
        page.value("""(async () => {
            const button = [...document.querySelectorAll('button')].find(
                (button) => button.innerText.trim() === '+ ball');
            for (let i = 0; i < 60; i++) {
                button.click();
                await new Promise((done) => setTimeout(done, 100));
            }
        })()""")
        arm.wait_for(lambda: len(arm.markers) >= before + 12, 'a dozen balls')
        hold(arm, page, 'KeyQ', lambda: arm.tip[2] > begin[2] + 0.01, 'motion all the same')
        arm.comes_to_rest()
        press(page, 'Delete all')
        arm.wait_for(lambda: not arm.markers, 'no obstacle')
        assert before + 60 < MOST_ITEMS


@pytest.mark.long
@IN_BROWSER
def test_attached_it_only_watches(tmp_path):
    with station() as (ros, processes):
        for publisher in (ros.joint_states, ros.obstacles):
            ros.node.destroy_publisher(publisher)
        values = {'urdf': PANDA_URDF}
        start = page_scenes(None)[0].arms[0].start
        file = Path('config/robots/panda.yaml')
        processes.start('fake_hardware_node', [file], {
            **values, 'initial_joints': list(start), 'initial_positions': list(start.values())})
        processes.start('planner_node', [file], values)
        ros.wait_for(lambda: ros.commands, 'joint_command')
        environment = dict(os.environ, ROS_DOMAIN_ID=str(ros.node.context.get_domain_id()))
        log = tmp_path / 'log'
        with log.open('w') as output:
            process = subprocess.Popen(
                [sys.executable, '-m', 'redundant_planner.tools.playground', '--attach',
                 '--port', '0'], env=environment, stdout=output, stderr=output)
        try:
            ros.wait_for(lambda: 'open http' in log.read_text(), 'the address')
            url = re.search(r'open (http://\S+)', log.read_text()).group(1)
            with Chromium() as chromium:
                page = chromium.open(url)
                page.wait_for(f'{FIGURES} && {FIGURES}.innerText.includes("manipulability")')
                assert not page.value(f'!!{TOKEN}')
                assert not ros.node.get_publishers_info_by_topic('obstacles')
                # The only one who commands is still the one who did.
                assert len(ros.node.get_publishers_info_by_topic('cmd_vel')) == 1
                ros.drive_until(np.array([0.0, 0.0, 0.05, 0.0, 0.0, 0.0]), ros.moves, 'motion')
                assert not page.errors
        finally:
            process.send_signal(signal.SIGINT)
            assert process.wait(PATIENCE) == 0, log.read_text()


@pytest.mark.long
@IN_BROWSER
def test_two_arms_are_driven_one_after_the_other(tmp_path):
    with playground(tmp_path) as (arm, url), Chromium() as chromium:
        page = chromium.open(url)
        ready(page)
        first = page.value(f'{TOKEN}.dataset.playgroundToken')
        choose(page, 'Panda past obstacles', 'Two arms')
        page.wait_for(f"{TOKEN} && {TOKEN}.dataset.playgroundToken !== '{first}'")
        for side in ('left', 'right'):
            if side == 'right':
                choose(page, 'left', 'right')
            topic = f'/{side}/joint_states'
            begin = arm.tip_of(topic)
            page.wait_for(f'{FIGURES} && {FIGURES}.innerText.includes("desired")')
            other = 'right' if side == 'left' else 'left'
            page.wait_for(f'{FIGURES}.innerText.includes("to {other}/")')
            # Further than one key's message takes it: the page has to go on driving.
            hold(arm, page, 'KeyQ', lambda t=topic, z=begin[2]: arm.tip_of(t)[2] > z + 0.12,
                 f'motion of the {side} arm')
            page.wait_for(f'!{FIGURES}.innerText.includes("silent")')
        picture(page, 'two_arms')
        assert not page.errors


def choose(page, shown, wanted):
    """Choose from a list that shows something by now."""
    x, y = page.value(f"""(() => {{
        const list = [...document.querySelectorAll('input')].find(
            (input) => input.value === '{shown}' && input.offsetParent);
        list.scrollIntoView({{block: 'center'}});
        const {{x, y, width, height}} = list.getBoundingClientRect();
        return [x + width / 2, y + height / 2];
    }})()""")
    page.click(x, y)
    option = f"""[...document.querySelectorAll('[role=option]')].find(
        (option) => option.innerText.trim() === '{wanted}')"""
    page.wait_for(option)
    page.value(f'{option}.click()')


def press(page, words):
    """Press a button by what is written on it, as fast as people do."""
    page.value(f"""new Promise((done) => setTimeout(() => done(
        [...document.querySelectorAll('button')].find(
            (button) => button.innerText.trim() === '{words}').click()), 300))""")


def drag(page, start, end):
    """Drag what is at one place to another one [px], in ten steps."""
    page.mouse('mouseMoved', *start)
    page.mouse('mousePressed', *start, held=True)
    for share in np.linspace(0.1, 1.0, 10):
        page.mouse('mouseMoved', *(np.array(start) + share * np.subtract(end, start)), held=True)
    page.mouse('mouseReleased', *end)


def seen_at(page, point):
    """Return where the page's first camera sees a point [px]."""
    eye, middle = np.array((1.45, -1.15, 1.05)), np.array((0.25, 0.0, 0.4))
    forward = (middle - eye) / np.linalg.norm(middle - eye)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    away = point - eye
    width, height = page.value('[innerWidth, innerHeight]')
    scale = 0.5 * height / np.tan(np.radians(75.0) / 2.0) / (away @ forward)
    return (0.5 * width + scale * (away @ right),
            0.5 * height - scale * (away @ np.cross(right, forward)))
