"""Robots that the tests share."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
import signal
import sysconfig
import time

from hypothesis import HealthCheck, settings
import numpy as np
import pytest
from ros_domains import next_domain
from standstill import Standstill, waited

from redundant_planner.core.parameters import AXES
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.resources import share_directory
from redundant_planner.io.robot_files import load_robot

# Their assertions, too, say what was compared.
pytest.register_assert_rewrite('bench', 'live_helpers')

# Jobs that a shell runs in its background ignore SIGINT, and so would all processes started here.
signal.signal(signal.SIGINT, signal.default_int_handler)

# An example may take as long as a busy machine lets it.
settings.register_profile(
    'long', deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile('short', settings.get_profile('long'), max_examples=20)

ROBOTS = share_directory() / 'config' / 'robots'
EXAMPLE_ROBOTS = (Path(sysconfig.get_paths()['purelib']) / 'cmeel.prefix' / 'share'
                  / 'example-robot-data' / 'robots')
PANDA_URDF = EXAMPLE_ROBOTS / 'panda_description' / 'urdf' / 'panda.urdf'
PANDA_READY = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])

LENGTHS = (0.5, 0.4, 0.3)


def planar_urdf(kinds=('revolute', 'revolute', 'continuous'), lengths=LENGTHS) -> str:
    """An arm in the x–y plane: joint i turns about z, then a link of lengths[i] along x."""
    parts = ['<robot name="planar"><link name="base"/>']
    parent, offset = 'base', 0.0
    for i, (kind, length) in enumerate(zip(kinds, lengths), start=1):
        limit = ('<limit velocity="2" effort="1"/>' if kind == 'continuous' else
                 '<limit lower="-2.5" upper="2.5" velocity="2" effort="1"/>')
        parts.append(
            f'<link name="link{i}"/><joint name="joint{i}" type="{kind}">'
            f'<parent link="{parent}"/><child link="link{i}"/><origin xyz="{offset} 0 0"/>'
            f'<axis xyz="0 0 1"/>{limit}</joint>')
        parent, offset = f'link{i}', length
    parts.append('<link name="tip"/><joint name="tip_joint" type="fixed">'
                 f'<parent link="{parent}"/><child link="tip"/>'
                 f'<origin xyz="{offset} 0 0"/></joint></robot>')
    return ''.join(parts)


def make_paper_arm(**changes) -> Robot:
    return load_robot(ROBOTS / 'paper_2p5r.yaml', **changes)


def make_panda(**changes) -> Robot:
    return load_robot(ROBOTS / 'panda.yaml', urdf=str(PANDA_URDF), **changes)


def make_planar(**options) -> Robot:
    return Robot(planar_urdf(), 'tip', **{'axes': ('vx', 'vy'), 'link_radius': 0.0, **options})


def two_handed_urdf(lengths=(0.28, 0.25, 0.1)) -> str:
    """A torso that rises and turns, with two arms of six joints on it that are not alike."""
    parts = ['<robot name="two_handed"><link name="base"/>']

    def add(joint: str, kind: str, parent: str, child: str, xyz: str, axis: str) -> None:
        limit = ('lower="0" upper="0.4" velocity="0.3"' if kind == 'prismatic' else
                 'lower="-2.6" upper="2.8" velocity="2"')
        parts.append(
            f'<link name="{child}"/><joint name="{joint}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="{child}"/><origin xyz="{xyz}"/><axis xyz="{axis}"/>'
            f'<limit {limit} effort="1"/></joint>')

    add('lift', 'prismatic', 'base', 'column', '0 0 0.5', '0 0 1')
    add('waist', 'revolute', 'column', 'torso', '0 0 0.2', '0 0 1')
    for side, way, stretch in (('left', 1.0, 1.0), ('right', -1.0, 1.2)):
        upper, lower, wrist = (stretch * length for length in lengths)
        parent = 'torso'
        for i, (xyz, axis) in enumerate((
                (f'0 {0.2 * way} 0.1', '0 1 0'), ('0.05 0 0', '0 0 1'), ('0 0 0', '1 0 0'),
                (f'{upper} 0 0', '0 1 0'), (f'{lower} 0 0', '1 0 0'),
                (f'0.06 0 {0.01 * way}', '0 1 0')), start=1):
            add(f'{side}{i}', 'revolute', parent, f'{side}_link{i}', xyz, axis)
            parent = f'{side}_link{i}'
        parts.append(f'<link name="{side}_hand"/><joint name="{side}_wrist" type="fixed">'
                     f'<parent link="{parent}"/><child link="{side}_hand"/>'
                     f'<origin xyz="{wrist} 0 0" rpy="0 1.2 0.3"/></joint>')
    return ''.join((*parts, '</robot>'))


HANDS = 'left_hand', 'right_hand'


def make_two_handed(**options) -> Robot:
    return Robot(two_handed_urdf(), **{'tips': HANDS, 'link_radius': 0.03, **options})


MAKERS = {
    'paper': make_paper_arm,
    'panda': make_panda,
    'panda_position': lambda: make_panda(axes=AXES[:3]),
    'panda_tool': lambda: make_panda(command_frame='tool'),
    'planar': make_planar,
    'two_handed': make_two_handed,
    'two_handed_tool': lambda: make_two_handed(
        command_frame='tool', axes={'left_hand': AXES[:3], 'right_hand': AXES}),
}


PASSED = pytest.StashKey[bool]()
# A standstill of the machine that a live test may fail of: commands and states may be as far apart
# as this before the arm stops by itself [s].
_STANDSTILL = 0.09
# Other work has the cores, disks or memory if somebody waits for such a share of a test's time.
# Live tests alone on two cores mostly wait for half of it.
_WAITING = 0.1
_MACHINE = pytest.StashKey[Standstill]()


def pytest_addoption(parser):
    parser.addoption('--long', action='store_true',
                     help='run the tests marked long, too, and those with random input in full')


def pytest_configure(config):
    settings.load_profile('long' if config.getoption('--long') else 'short')


def examples(in_full: int) -> int:
    """Return how many examples a test with random input takes; `in_full` with --long."""
    share = settings().max_examples / settings.get_profile('long').max_examples
    return max(round(share * in_full), 3)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Leave out what is long, and mark what takes live processes, for side_by_side.py."""
    for item in items:
        if item.get_closest_marker('flaky') or 'paper_runs' in item.fixturenames:
            item.add_marker(pytest.mark.live)
    if config.getoption('--long'):
        return
    short, long, begun = [], [], set()
    for item in items:
        test = item.nodeid.partition('[')[0]
        is_long = item.get_closest_marker('long') or (
            test in begun and item.get_closest_marker('first_alone'))
        begun.add(test)
        (long if is_long else short).append(item)
    items[:] = short
    config.hook.pytest_deselected(items=long)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    """Watch the machine from the first live test on, for `live_helpers.LIVE`."""
    if item.get_closest_marker('flaky') is None:
        return
    config, begin, waited_before = item.config, time.time(), waited()
    if _MACHINE not in config.stash:
        machine = config.stash[_MACHINE] = Standstill().__enter__()
        config.add_cleanup(lambda: machine.__exit__(None, None, None))

    def was_hindered() -> bool:
        now = time.time()
        return (config.stash[_MACHINE].longest(begin, now) > _STANDSTILL
                or waited() - waited_before > _WAITING * (now - begin))

    config.was_hindered = was_hindered


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """Tell fixtures whether their test passed."""
    report = yield
    if call.when == 'call':
        item.stash[PASSED] = report.passed
    return report


def pytest_runtest_logreport(report):
    """Say why a test is tried again; pytest only says that it is."""
    if report.outcome == 'rerun':
        crash = getattr(report.longrepr, 'reprcrash', None)
        reason = crash.message if crash else report.longreprtext
        print(f'\n{report.nodeid} is tried again: {reason[:500]}')


@pytest.fixture
def machine(request) -> Standstill:
    """What tells a live test when the machine stood still."""
    return request.config.stash[_MACHINE]


@pytest.fixture(params=MAKERS)
def robot(request) -> Robot:
    return MAKERS[request.param]()


@pytest.fixture
def paper_arm() -> Robot:
    return make_paper_arm()


@pytest.fixture
def panda() -> Robot:
    return make_panda()


@pytest.fixture
def planar() -> Robot:
    return make_planar()


def random_postures(robot: Robot, count: int, seed: int = 0) -> np.ndarray:
    """Postures inside the limits, a little away from them."""
    low = np.where(np.isfinite(robot.position_min), robot.position_min, -np.pi)
    high = np.where(np.isfinite(robot.position_max), robot.position_max, np.pi)
    margin = 0.05 * (high - low)
    return np.random.default_rng(seed).uniform(low + margin, high - margin, (count, robot.n))


def central_difference(function, q: np.ndarray, step: float = 1e-6) -> np.ndarray:
    """∂function/∂q by central differences; the last axis runs over q."""
    return np.stack([(np.asarray(function(q + step * e)) - np.asarray(function(q - step * e)))
                     / (2.0 * step) for e in np.eye(len(q))], axis=-1)


@pytest.fixture(scope='session')
def paper_runs(tmp_path_factory):
    """The paper's scenario played live, every tick recorded, side by side; method → bag."""
    folder = tmp_path_factory.mktemp('paper_runs')
    methods = ('dynamic_factor', 'variational')
    with ThreadPoolExecutor(len(methods)) as pool:
        bags = pool.map(_paper_run, methods, [folder] * len(methods),
                        [next_domain() for _ in methods])
        return dict(zip(methods, bags))


def _paper_run(method, folder, domain):
    """Play by simulated time: a machine that stands still interrupts nothing."""
    from forked_nodes import ForkedProcesses

    from redundant_planner.io.scenario import load_scenario
    from redundant_planner.tools.live_run import play
    file = share_directory() / 'config' / 'scenarios' / 'paper.yaml'
    return play(load_scenario(file), file, folder / method, domain_id=domain,
                planner_values={'publish_ticks': True, 'method': method},
                kind=ForkedProcesses, simulated_time=True).bag
