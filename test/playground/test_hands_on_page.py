"""A body with two hands on the page: a handle for each, or one for what both hold.

The page's own process with its planner and arm, and a visitor who speaks viser's protocol.
"""

from __future__ import annotations

from contextlib import ExitStack
import os
import re
import signal
import subprocess
import sys
from urllib.parse import parse_qs, urlsplit
from urllib.request import urlopen

from conftest import HANDS, make_two_handed, two_handed_urdf
from live_helpers import LIVE, PATIENCE, station
import msgspec
import numpy as np
import pytest
from test_letting_go import CAMERA
import viser
from websockets.sync.client import connect
import yaml
import zstandard

from redundant_planner.core.target.start_posture import start_posture

pytestmark = [pytest.mark.live, LIVE]
BODY = make_two_handed()
NAMES = list(BODY.joint_names)


class Visitor:
    """What a browser sees: handles by their names, boxes to check by their labels."""

    def __init__(self, connection):
        self.handles, self.boxes, self._connection = {}, {}, connection
        connection.send(msgspec.msgpack.encode(CAMERA))

    def look(self):
        """Take in what has come."""
        try:
            while True:
                raw = self._connection.recv(timeout=0)
                shown = zstandard.ZstdDecompressor().decompressobj().decompress(raw[16:])
                for message in _messages(msgspec.msgpack.decode(shown)):
                    self._take(message)
        except TimeoutError:
            pass

    def _take(self, message):
        name, kind = message.get('name', ''), message['type']
        if kind == 'TransformControlsMessage' and name.startswith('/handle'):
            self.handles[name] = {'owner': message.get('owner', ''),
                                  'wxyz': np.array((1.0, 0.0, 0.0, 0.0))}
        elif kind == 'SetPositionMessage' and name in self.handles:
            self.handles[name]['position'] = np.array(message['position'])
        elif kind == 'SetOrientationMessage' and name in self.handles:
            self.handles[name]['wxyz'] = np.array(message['wxyz'])
        elif kind == 'RemoveSceneNodeMessage':
            self.handles.pop(name, None)
        elif kind == 'GuiCheckboxMessage':
            self.boxes[message['props']['label']] = message['uuid']

    def drag(self, name, way):
        """Drag a handle by (3,) [m]; it is not let go."""
        handle = self.handles[name]
        for kind, more in (
                ('TransformControlsDragStartMessage', {}),
                ('TransformControlsUpdateMessage', {
                    'wxyz': handle['wxyz'].tolist(),
                    'position': (handle['position'] + way).tolist()}),
                ('TransformControlsDragEndMessage', {})):
            self._connection.send(msgspec.msgpack.encode(
                {'type': kind, 'name': name, 'owner': handle['owner'], **more}))

    def check(self, label, value):
        """Check a box, or not."""
        self._connection.send(msgspec.msgpack.encode({
            'type': 'GuiUpdateMessage', 'uuid': self.boxes[label], 'updates': {'value': value}}))


def _messages(found):
    """All messages in what viser sends at once."""
    if isinstance(found, dict) and 'type' in found:
        yield found
    elif isinstance(found, dict | list):
        for part in found.values() if isinstance(found, dict) else found:
            yield from _messages(part)


def test_each_hand_has_a_handle_and_so_has_what_both_hold(tmp_path):
    file, log, start = tmp_path / 'body.yaml', tmp_path / 'log', start_posture(BODY)
    file.write_text(yaml.dump({'/**': {'ros__parameters': {
        'robot_description': two_handed_urdf(), 'tips': list(HANDS), 'link_shapes': 'straight',
        'link_radius': 0.03, 'drive.dead_time': 0.006, 'initial_joints': NAMES,
        'initial_positions': start.tolist()}}}))
    with station() as (ros, _), ExitStack() as end:
        ros.node.destroy_publisher(ros.joint_states)  # the page begins where no arm is
        output = end.enter_context(log.open('w'))
        process = subprocess.Popen(
            [sys.executable, '-m', 'redundant_planner.tools.playground', '--robot', str(file),
             '--port', '0', '--recordings', str(tmp_path)], stdout=output, stderr=output,
            env=dict(os.environ, ROS_DOMAIN_ID=str(ros.node.context.get_domain_id())))
        end.callback(process.wait)
        end.callback(process.kill)
        ros.wait_for(lambda: 'open http' in log.read_text() or process.poll() is not None, 'it')
        with urlopen(re.search(r'open (http\S+)', log.read_text()).group(1)) as page:
            address, = parse_qs(urlsplit(page.url).query)['websocket']
        visitor = Visitor(end.enter_context(connect(
            address, subprotocols=[f'viser-v{viser.__version__}'], max_size=None)))

        def tips():
            return BODY.kinematics(ros.state(NAMES)).tip_positions

        ros.wait_for(lambda: ros.commands and len(visitor.handles) == 2 and all(
            'position' in handle for handle in visitor.handles.values()), 'two handles',
            meanwhile=visitor.look)
        assert set(visitor.handles) == {f'/handle_{tip}' for tip in HANDS}
        before = tips()
        visitor.drag('/handle_right_hand', (0.0, 0.0, 0.04))
        ros.wait_for(lambda: np.abs(tips() - before - ((0, 0, 0), (0, 0, 0.04))).max() < 2e-3,
                     'the right hand', meanwhile=visitor.look)

        ros.wait_for(ros.at_rest, 'rest', meanwhile=visitor.look)
        before = tips()
        visitor.check('both hands hold one object', True)
        ros.wait_for(lambda: set(visitor.handles) == {'/handle_object'}, 'the object',
                     meanwhile=visitor.look)
        np.testing.assert_allclose(
            visitor.handles['/handle_object']['position'], before.mean(axis=0), atol=2e-3)
        visitor.drag('/handle_object', (0.0, 0.0, 0.05))
        ros.wait_for(lambda: np.abs(tips() - before - (0.0, 0.0, 0.05)).max() < 2e-3,
                     'the object at its place', meanwhile=visitor.look)
        ros.wait_for(ros.at_rest, 'rest', meanwhile=visitor.look)
        visitor.check('both hands hold one object', False)
        ros.wait_for(lambda: len(visitor.handles) == 2, 'two handles', meanwhile=visitor.look)
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0, log.read_text()
        assert 'Traceback' not in log.read_text(), log.read_text()
