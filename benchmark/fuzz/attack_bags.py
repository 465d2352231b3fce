"""Bags that are damaged, made up or malicious, for analysis, report, replay and repair."""

from __future__ import annotations

import bz2
from collections.abc import Callable
import contextlib
from html.parser import HTMLParser
import io
import json
from pathlib import Path
import resource
import struct
from typing import Any

from backports import zstd
import numpy as np
from rich.console import Console
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from rosbags.typesys import get_typestore, Stores

from benchmark.fuzz.damaged_bags import CHANGES, damaged, KINDS, Recorded, sound
from benchmark.fuzz.tally import Tally
from redundant_planner.analysis.bag_analysis import analyse
from redundant_planner.analysis.measure_tables import reductions
from redundant_planner.analysis.replay_inputs import Inputs, read_inputs, ticks_of_topics
from redundant_planner.analysis.report import page_of
from redundant_planner.analysis.report_figures import write_figures
from redundant_planner.analysis.results import Analysis
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.io.bag_reader import open_bag
from redundant_planner.io.bag_repair import repair
from redundant_planner.io.parameter_files import settings_of
from redundant_planner.io.recorded_tick import TickKind
from redundant_planner.io.recording import read_recording
from redundant_planner.tools.analyze_bag import (
    as_json,
    chunk_table,
    joint_table,
    main as analyze_bag,
    motion_table,
    peak_table,
)
from redundant_planner.tools.replay_bag import main as replay_bag, write_replay
from redundant_planner.tools.replayed_ticks import again, otherwise, Replay

Random = np.random.Generator

# More than a bag of 0.2 MB may take [kB].
_MEMORY = 1_500_000


def attack(random: Random, folder: Path, tally: Tally) -> None:
    """Damage a bag in one way, and do everything with it that the commands do."""
    messages, kinds = list(sound()[0]), dict(KINDS)
    if random.random() < 0.4:  # without ticks a replay makes them up
        messages = [m for m in messages if not m.topic.endswith('ticks')]
    for _ in range(int(random.integers(0, 4))):
        change = CHANGES[random.integers(len(CHANGES))]
        messages = change(random, messages, kinds)
    path = folder / 'bag'
    compressed = random.choice(['no', 'no', 'chunks', 'messages', 'file'])
    sqlite = random.random() < 0.2 and compressed != 'chunks'
    _write(path, messages, kinds, sqlite=sqlite, compressed=str(compressed))
    if random.random() < 0.5:
        (path / 'metadata.yaml').unlink()
    file = next(f for f in sorted(path.iterdir()) if f.name != 'metadata.yaml')
    for _ in range(int(random.integers(0, 3))):
        file.write_bytes(damaged(random, file.read_bytes()))
    if random.random() < 0.1:
        (path / 'second.mcap').write_bytes(damaged(random, file.read_bytes()))
    if random.random() < 0.05:
        file.write_bytes(_bomb(random))

    with contextlib.redirect_stderr(io.StringIO()):  # progress bars
        _use(random, path, folder, tally)


def _use(random: Random, path: Path, folder: Path, tally: Tally) -> None:
    """Do with a bag what the commands do."""
    found = tally.attempt(lambda: _frugally(lambda: analyse(path)))
    if found is not None:
        _check_analysis(found, tally)
        if random.random() < 0.3:
            tally.attempt(lambda: _shown(found))
        if random.random() < 0.01:
            tally.attempt(lambda: write_figures(folder, found, ('png',)))
    inputs = tally.attempt(lambda: _frugally(lambda: _inputs(path)))
    if inputs is not None:
        _replay(random, inputs, path, folder, tally)
    if random.random() < 0.3:
        tally.attempt(lambda: read_recording(path))
    if random.random() < 0.2:
        tally.attempt(lambda: _commanded(random, path, folder))
    tally.attempt(lambda: repair(path))
    if random.random() < 0.2:
        tally.attempt(lambda: analyse(path))


def _inputs(path: Path) -> Inputs:
    with open_bag(path) as bag:
        return read_inputs(bag, None, '', '')


def _frugally(action: Callable[[], Any]) -> Any:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    result = action()
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    if used > _MEMORY:
        raise MemoryError(f'{used} kB for a small bag')
    return result


def _check_analysis(found: Analysis, tally: Tally) -> None:
    curves = found.curves
    tally.check_finite(
        *vars(found.joints).values(), curves.times, curves.positions, curves.velocities,
        curves.accelerations, found.factor, found.begin, found.end)
    # These are NaN or infinite where there is nothing to measure, but never the other.
    tally.check_finite(np.nan_to_num(curves.scale, nan=0.0, posinf=np.inf, neginf=-np.inf),
                       np.nan_to_num(curves.path_error, nan=0.0, posinf=np.inf),
                       np.nan_to_num(curves.clearance, nan=np.nan, posinf=0.0),
                       np.nan_to_num(found.distance, nan=np.nan, posinf=0.0))
    if found.clearance is not None:
        tally.check_finite(found.clearance.level)
    if not all(note.isprintable() for note in found.notes):
        raise AssertionError('a note cannot be printed')


class _Scripts(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.count += tag == 'script'


def _shown(found: Analysis) -> None:
    console = Console(markup=False, emoji=False, file=io.StringIO(), width=200)
    console.print(joint_table(found), peak_table(found), chunk_table(found))
    console.print(motion_table([found, found]))
    json.dumps(as_json(found))
    reductions(found, found)
    page = page_of([found])
    parser = _Scripts()
    parser.feed(page)
    if parser.count != 2:
        raise AssertionError(f'{parser.count} script elements in the page')
    if len(page) > 60_000_000:
        raise AssertionError(f'a page of {len(page)} characters')


def _replay(
    random: Random, inputs: Inputs, path: Path, folder: Path, tally: Tally,
) -> None:
    parameters = tally.attempt(lambda: settings_of(PlannerParameters, inputs.values))
    if parameters is None:
        return
    if inputs.ticks:
        repeated = tally.attempt(lambda: again(inputs, parameters))
        if repeated is not None:
            tally.check_finite(repeated.times, repeated.positions, repeated.velocities)
    if sum(end - begin for begin, end, _ in inputs.parts) > 20.0:
        return  # as long as it lasts
    method = str(random.choice(['dynamic_factor', 'variational', 'gradient_projection']))
    replay = tally.attempt(lambda: otherwise(inputs, PlannerParameters(method=method)))
    if replay is None:
        return
    if tally.check_finite(replay.times, replay.positions, replay.velocities):
        tally.limit_violations += not _within_limits(inputs, replay)
    if random.random() < 0.3:
        with open_bag(path) as bag:
            origin = bag.origin_ns
        tally.attempt(lambda: write_replay(folder / 'replayed', inputs, replay, origin, 'x'))


def _within_limits(inputs: Inputs, replay: Replay) -> bool:
    robot = inputs.robot
    ticks = inputs.ticks or ticks_of_topics(inputs)
    rate = inputs.values.get('rate', 250)
    before = np.vstack((np.zeros(robot.n), replay.velocities[:-1]))
    if not inputs.ticks:
        before[[tick.kind == TickKind.STARTING for _, tick in ticks]] = 0.0
    acceleration = np.abs(replay.velocities - before) * (
        rate if isinstance(rate, int) and 1 <= rate <= 1000 else 250)
    return bool((np.abs(replay.velocities) <= robot.velocity_max * (1 + 1e-6)).all()
                and (acceleration <= robot.acceleration_max * (1 + 1e-6) + 1e-6).all())


def _commanded(random: Random, path: Path, folder: Path) -> None:
    """Run the commands as a user does: an exit status and lines, no traceback."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        if random.random() < 0.5:
            status = analyze_bag([str(path), '--csv', str(folder / 'curves.csv')])
        else:
            status = replay_bag([str(path), '--out', str(folder / 'other')])
    if status not in (0, 2) or (status == 2 and len(err.getvalue().splitlines()) != 1):
        raise AssertionError(f'exit status {status}: {err.getvalue()}')


def _write(
    path: Path, messages: list[Recorded], kinds: dict[str, str], *, sqlite: bool, compressed: str,
) -> None:
    types = get_typestore(Stores.ROS2_JAZZY)
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3 if sqlite
                    else StoragePlugin.MCAP)
    if compressed != 'no':
        writer.set_compression({
            'chunks': CompressionMode.STORAGE, 'messages': CompressionMode.MESSAGE,
            'file': CompressionMode.FILE}[compressed], CompressionFormat.ZSTD)
    with writer:
        connections = {topic: writer.add_connection(topic, kind, typestore=types)
                       for topic, kind in kinds.items()}
        for message in messages:
            writer.write(connections[message.topic],
                         min(max(message.time, 0), 2**63 - 1 if sqlite else 2**64 - 2),
                         message.raw)


def _bomb(random: Random) -> bytes:
    """Return a file that unpacks to far too much."""
    what = random.integers(4)
    packed = zstd.compress(bytes(200_000_000))
    if what == 0:
        return packed  # as a file
    if what == 1:
        return bz2.compress(bytes(1_000_000))
    chunk = struct.pack('<QQQI', 0, 2**40, int(random.choice([10, 200_000_000, 2**62])), 0)
    chunk += struct.pack('<I', 4) + b'zstd' + struct.pack('<Q', len(packed)) + packed
    header = struct.pack('<I', 4) + b'ros2' + struct.pack('<I', 0)
    return b'\x89MCAP0\r\n' + b''.join(
        struct.pack('<BQ', kind, len(content)) + content
        for kind, content in ((1, header), *[(6, chunk)] * 5))
