"""Films: what can be said before the motion, and what is drawn after it."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
from PIL import Image
import pytest

from redundant_planner.physics import film, PhysicsError

# Draws a second of an arm that turns, in a process that chooses its OpenGL before MuJoCo comes.
_SCRIPT = """
import sys
from pathlib import Path
import numpy as np
from conftest import make_panda, PANDA_READY
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.physics import film, PhysicsError
try:
    film.choose_gl()
except PhysicsError as error:
    print(error)
    raise SystemExit(3)
from redundant_planner.io.physics_parameters import PhysicsParameters
from redundant_planner.physics.arm import PhysicsArm
robot = make_panda()
arm = PhysicsArm(robot, PhysicsParameters(), dict(zip(robot.joint_names, PANDA_READY)))
record = film.Film(Path(sys.argv[1]), arm.model)
arm.advance(0.0)
turn = np.zeros(8)
turn[0] = 1.0
for i in range(250):
    ball = Obstacle('ball', (0.5, 0.4 - 0.002 * i, 0.5), (0.05, 0.05, 0.05))
    arm.surround(Scene.of([ball]))
    arm.command(i * 0.004, turn)
    arm.advance((i + 1) * 0.004)
    record.note(arm.data)
print(record.write())
"""


def pictures(path):
    """All pictures of a film (k, height, width, 3)."""
    with Image.open(path) as film_file:
        found = []
        for i in range(film_file.n_frames):
            film_file.seek(i)
            found.append(np.asarray(film_file.convert('RGB')))
    return np.array(found)


def test_pictures_come_back_from_a_film(tmp_path):
    path = tmp_path / 'film.gif'
    given = np.zeros((3, film._HEIGHT, film._WIDTH, 3), dtype=np.uint8)
    for i, color in enumerate(((255, 0, 0), (0, 255, 0), (0, 0, 255))):
        given[i, :, 100 * i:100 * i + 50] = color
    film._write(path, iter(given))
    np.testing.assert_allclose(pictures(path), given, atol=8)


@pytest.mark.long
def test_an_arm_is_drawn_where_there_is_opengl(tmp_path):
    """Where there is none, the reason is told; where there is one, the pictures differ."""
    path = tmp_path / 'arm.gif'
    done = subprocess.run(
        [sys.executable, '-c', _SCRIPT, str(path)], capture_output=True, text=True,
        env=dict(os.environ, PYTHONPATH=os.pathsep.join(sys.path)), timeout=120)
    if done.returncode == 3:
        assert 'no OpenGL draws offscreen here (egl: ' in done.stdout
        pytest.skip(done.stdout.strip())
    assert done.returncode == 0, done.stderr
    drawn = pictures(path)
    assert len(drawn) == int(done.stdout) == 20
    assert (np.abs(np.diff(drawn.astype(int), axis=0)).sum(axis=(1, 2, 3)) > 10_000).all()


@pytest.mark.parametrize('name, reason', [
    ('film.avi', 'is neither .gif nor .mp4'), ('nowhere/film.gif', 'in a folder that does not')])
def test_files_that_cannot_be_written_are_told_before_the_motion(tmp_path, name, reason):
    with pytest.raises(PhysicsError, match=reason):
        film.check_file(tmp_path / name)


def test_mp4_needs_ffmpeg(tmp_path, monkeypatch):
    monkeypatch.setenv('PATH', str(tmp_path))
    with pytest.raises(PhysicsError, match='takes the command ffmpeg'):
        film.check_file(tmp_path / 'film.mp4')
    # One that fails says why.
    program = tmp_path / 'ffmpeg'
    program.write_text('#!/bin/sh\necho "no such codec" >&2\nexit 1\n')
    program.chmod(0o755)
    film.check_file(tmp_path / 'film.mp4')
    with pytest.raises(Exception) as caught:
        film._write(tmp_path / 'film.mp4', iter(np.zeros((3, 480, 640, 3), dtype=np.uint8)))
    assert 'ffmpeg' in str(caught.value)
