"""Do the tests notice? Each mutation breaks one thing; the tests named with it should fail.

    python test/mutations.py [--only N …] [--jobs 2]

Each is made in a copy of the working tree, with a cache of machine code of its own: a copy of the
tree's, which serves where the mutation is in nothing that is compiled. A mutation that survives is
a property that no test holds: write that test.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ThreadPoolExecutor
import os
from pathlib import Path
import shutil
import subprocess
import sys
import tempfile
import time
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = 'redundant_planner'
_COMPILED = ROOT / PACKAGE / 'core' / '__pycache__'
# How long the tests of a mutation may take before it counts as noticed: it hangs [s].
_PATIENCE = 1500.0
_FAILED = 1


class Mutation(NamedTuple):
    """One thing broken.

    Attributes:
        file: in the package.
        tests: files or folders in test/ that should notice.
        what: it breaks, in words.
        old, new: the text that stands there exactly once, and what takes its place.
    """

    file: str
    tests: str
    what: str
    old: str
    new: str


MUTATIONS = (
    Mutation(
        'core/safety/limits.py', 'core/safety',
        'joints brake too late for the ends of their ranges',
        'speed = max(room, 0.0) / (stop / 2.0 + dt)',
        'speed = max(room, 0.0) / (stop / 4.0 + dt)'),
    Mutation(
        'core/safety/limits.py', 'core/safety',
        'bounds that leave no room pass for kept',
        'kept, fastest = False, max(fastest, min(',
        'kept, fastest = True, max(fastest, min('),
    Mutation(
        'core/safety/pace.py', 'core/safety core/obstacles',
        'what is not looked at recedes as the arm moves',
        'unseen[link] -= way_of_link(',
        'unseen[link] += way_of_link('),
    Mutation(
        'core/safety/barriers.py', 'core/safety',
        'obstacles that come are taken to go',
        'return -rate * value - time_derivative',
        'return -rate * value + time_derivative'),
    Mutation(
        'core/safety/barriers.py', 'core/safety core/obstacles',
        'allowed contacts are left in a hurry',
        'rows.value[at] = max(rows.value[at], 0.0)',
        'rows.value[at] = rows.value[at]'),
    Mutation(
        'core/safety/jerk.py', 'core/safety',
        'a fading mean is taken to stop in half its way',
        'return posture + self._delay * self._mean',
        'return posture + 0.5 * self._delay * self._mean'),
    Mutation(
        'core/safety/jerk.py', 'core/safety',
        'corners count as cut twice as far',
        '* dt * dt / 24.0',
        '* dt * dt / 12.0'),
    Mutation(
        'core/safety/position_command.py', 'core/safety nodes',
        'commanded positions stop a tick too late',
        'return np.sqrt(gain * gain + 2.0 * acceleration * distance) - gain',
        'return np.sqrt(gain * gain + 2.0 * acceleration * distance)'),
    Mutation(
        'core/safety/following.py', 'core/safety',
        'a drive with a gain of 0.95 does not follow',
        '_GAIN = 1.1',
        '_GAIN = 1.0'),
    Mutation(
        'core/obstacles/clearance.py', 'core/obstacles',
        'links are twice as long for ellipsoids',
        'squared, _TINY), 0.0), 1.0)',
        'squared, _TINY), 0.0), 2.0)'),
    Mutation(
        'core/obstacles/shapes.py', 'core/obstacles',
        'a box is as high as it is wide',
        'return Place(abs(at.x) - half.x, abs(at.y) - half.y, abs(at.z) - half.z)',
        'return Place(abs(at.x) - half.x, abs(at.y) - half.y, abs(at.z) - half.y)'),
    Mutation(
        'core/obstacles/near_pairs.py', 'core/obstacles core/test_array_bounds.py core/safety',
        'barriers beyond the room for rows slow nothing down',
        'elif spare[i] <= 0.0:\n            unseen[links[i]] = min(unseen[links[i]], '
        'distance[i])',
        'elif spare[i] <= -1e9:\n            unseen[links[i]] = min(unseen[links[i]], '
        'distance[i])'),
    Mutation(
        'core/obstacles/nearby.py', 'core/obstacles',
        'a choice of obstacles holds for too long',
        'may = ranges[link] - reach[link]',
        'may = ranges[link] + reach[link]'),
    Mutation(
        'core/obstacles/motion_estimate.py', 'core/obstacles io',
        'an obstacle that nobody reports goes on moving',
        'now - tracks.heard > STATIC_AFTER',
        'now - tracks.heard > 100.0 * STATIC_AFTER'),
    Mutation(
        'core/obstacles/motion_estimate.py', 'core/obstacles io',
        'after a clock was set back obstacles stay where they were',
        'set_back = elapsed < -STATIC_AFTER',
        'set_back = elapsed < -1e9'),
    Mutation(
        'core/robot/links_after.py', 'core/robot',
        'link ends are turned the wrong way',
        'end[link, axis] += rotation[axis, k] * links.end[link, k]',
        'end[link, axis] += rotation[k, axis] * links.end[link, k]'),
    Mutation(
        'core/robot/joint_observer.py', 'core/robot',
        'a dead time between two ticks is taken for the rest of it',
        'wanted = part * late[0, i] + (1.0 - part) * late[1, i]',
        'wanted = part * late[1, i] + (1.0 - part) * late[0, i]'),
    Mutation(
        'core/robot/cone.py', 'core/safety core/robot',
        "the cone's second derivative has a wrong sign",
        'found.change[0] = (np.sum(second * d) + cosine * rate * rate)',
        'found.change[0] = (np.sum(second * d) - cosine * rate * rate)'),
    Mutation(
        'core/robot/payload.py', 'core/robot',
        'a carried cylinder sticks out of its capsule',
        'return max(half_height - radius * float(x[best]), 0.0)',
        'return max(half_height - 2.0 * radius * float(x[best]), 0.0)'),
    Mutation(
        'core/redundancy/criteria.py', 'core/redundancy core/test_planner.py',
        'Eq. 18 drives joints to their limits',
        'weights.k_w * clearance - weights.k_s * joint_limit',
        'weights.k_w * clearance + weights.k_s * joint_limit'),
    Mutation(
        'core/redundancy/command.py', 'core/redundancy core/test_planner.py',
        'speed limits hold for each axis by itself',
        'math.sqrt(x * x + y * y + z * z) / limit)',
        'max(abs(x), abs(y), abs(z)) / limit)'),
    Mutation(
        'core/redundancy/null_space.py', 'core/redundancy',
        'null-space motion moves the tip',
        'turned[row, i] -= 2.0 * along / length * mirror[i]',
        'turned[row, i] -= 1.0 * along / length * mirror[i]'),
    Mutation(
        'core/horizon/preview.py', 'core/horizon',
        'a preview is integrated as if it were held',
        '0.5 * (self.twists[:-1] + self.twists[1:])',
        '1.0 * self.twists[:-1]'),
    Mutation(
        'core/horizon/path_qp.py', 'core/horizon',
        'a joint path through an obstacle costs nothing',
        'return _INTRUSION_PRICE * max(intrusion + CLEARANCE_RESERVE, 0.0)',
        'return _INTRUSION_PRICE * max(intrusion - 1.0, 0.0)'),
    Mutation(
        'core/target/straight_motion.py', 'core/target',
        'straight motions are taken to be free too soon',
        'narrow = narrow or span * motion.far[k] > rooms[one, k] + rooms[other, k]',
        'narrow = narrow or span * motion.far[k] > 4.0 * (rooms[one, k] + rooms[other, k])'),
    Mutation(
        'core/target/smoother.py', 'core/target test_streams.py',
        'outliers of a stream are followed',
        'if off <= 1.0 + most:',
        'if True:'),
    Mutation(
        'core/target/profile.py', 'core/target',
        'ways to a target do not end at rest',
        'speed[-1] = 0.0',
        'speed[-1] = speed[-2]'),
    Mutation(
        'core/target/chunk_follower.py', 'core/target nodes/test_chunk_input.py test_chunks.py',
        'a chunk that comes by its end is reached too soon',
        'if self._is_over and self._followed is chunk and',
        'if self._followed is chunk and'),
    Mutation(
        'core/target/tree_growth.py', 'core/target',
        'all branches grow from the root',
        'root, size = _nearest(trees, tree, aim, scaling)',
        'root, size = 0, _nearest(trees, tree, aim, scaling)[1]'),
    Mutation(
        'nodes/supervisor.py', 'nodes/test_supervisor.py',
        'a stick that drops out for a moment moves an arm that wakes up',
        'now - self._quiet_since >= FRESH_AFTER',
        'now - self._quiet_since >= -1.0'),
    Mutation(
        'nodes/supervisor.py', 'nodes/test_supervisor.py',
        'a clock that is set back is not noticed',
        '0.0 <= gap <= LONGEST_GAP',
        'gap <= LONGEST_GAP'),
    Mutation(
        'nodes/tick_phase.py', 'nodes/test_tick_phase.py',
        'commands go to the wrong side of the middle',
        'return (after + 0.5) % 1.0 * period',
        'return (1.5 - after) % 1.0 * period'),
    Mutation(
        'nodes/chores.py', 'nodes/test_chores.py',
        'after a clock was set back nothing is due for long',
        'or self._due[i] > now + period',
        ''),
    Mutation(
        'nodes/lock_step.py', 'nodes/test_lock_step.py',
        'who has gone is waited for in every period',
        'self.in_step &= self._answered',
        'pass'),
    Mutation(
        'nodes/guard.py', 'nodes/test_guard.py',
        'a fault in every tick floods the log',
        'if now - self._said.get(place, -_LOG_PERIOD) >= _LOG_PERIOD:',
        'if True:'),
    Mutation(
        'io/joint_turns.py', 'io/test_joint_turns.py',
        'turns are forgotten after the next message',
        'turned = self.turned + np.cumsum(',
        'turned = np.cumsum('),
    Mutation(
        'io/joint_parts.py', 'io/test_joint_parts.py',
        'joint states in parts do not wait for each other',
        'latest = min(times[there].max()',
        'latest = max(times[there].max()'),
    Mutation(
        'io/cdr.py', 'io nodes/test_hostile_messages.py',
        'names are as long as bytes say',
        'if length > LONGEST_NAME + 1:',
        'if False:'),
    Mutation(
        'perception/voxel_memory.py', 'perception',
        'what the camera looks through stays',
        'kept = ~free & (seen_at',
        'kept = (seen_at'),
    Mutation(
        'perception/scene_shapes.py', 'perception',
        "a scene's balls have half their size",
        'np.full(3, 2.0 * given[0])',
        'np.full(3, given[0])'),
    Mutation(
        'analysis/metrics.py', 'analysis',
        'a path error is measured to the farthest piece',
        't[:, None] * along - point, axis=1).min()',
        't[:, None] * along - point, axis=1).max()'),
    Mutation(
        'physics/contacts.py', 'physics',
        'a contact that lasts counts again and again',
        'key not in self._touching and',
        ''),
)


def seen_by_tests(mutation: Mutation, folder: Path) -> bool:
    """Make a mutation in a copy of the tree; return whether its tests fail."""
    path = folder / PACKAGE / mutation.file
    source = path.read_text()
    path.write_text(source.replace(mutation.old, mutation.new))
    try:
        with tempfile.TemporaryDirectory() as cache:
            shutil.copytree(_COMPILED, cache, dirs_exist_ok=True)
            status = subprocess.run(
                [sys.executable, '-m', 'pytest', '-x', '-q', '-p', 'no:cacheprovider',
                 '-p', 'no:rerunfailures', '-m', 'not live',
                 *(f'test/{name}' for name in mutation.tests.split())],
                cwd=folder, timeout=_PATIENCE, capture_output=True,
                env={**os.environ, 'PYTHONPATH': str(folder), 'NUMBA_CACHE_DIR': cache}).returncode
    except subprocess.TimeoutExpired:
        return True
    finally:
        path.write_text(source)
    return status == _FAILED


def _copy(to: Path) -> None:
    """Copy what git knows of the working tree."""
    names = subprocess.run(['git', 'ls-files'], cwd=ROOT, check=True, capture_output=True,
                           text=True).stdout.split('\n')
    for name in filter(None, names):
        (to / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, to / name)


def main() -> int:
    """Try all; return how many survive."""
    parser = argparse.ArgumentParser(prog='python test/mutations.py', description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--only', type=int, nargs='+', help='numbers of mutations')
    parser.add_argument('--jobs', type=int, default=2)
    options = parser.parse_args()
    for mutation in MUTATIONS:
        count = (ROOT / PACKAGE / mutation.file).read_text().count(mutation.old)
        if count != 1:
            parser.error(f'{mutation.file} has {mutation.old!r} {count} times, not once')
    chosen = options.only or range(1, len(MUTATIONS) + 1)
    with tempfile.TemporaryDirectory() as folder:
        trees = [Path(folder) / str(i) for i in range(options.jobs)]
        for tree in trees:
            _copy(tree)

        def judged(number: int) -> bool:
            tree, begin = trees.pop(), time.monotonic()
            mutation = MUTATIONS[number - 1]
            try:
                seen = seen_by_tests(mutation, tree)
            finally:
                trees.append(tree)
            print(f'{number:3d} {"seen" if seen else "SURVIVES":8s} {mutation.file}: '
                  f'{mutation.what} ({time.monotonic() - begin:.0f} s)', flush=True)
            return seen

        with ThreadPoolExecutor(options.jobs) as pool:
            seen = list(pool.map(judged, chosen))
    print(f'{sum(seen)} of {len(seen)} seen')
    return len(seen) - sum(seen)


if __name__ == '__main__':
    sys.exit(main())
