"""Films of the arm, rendered offscreen after the motion: drawing takes longer than moving.

Nothing here needs MuJoCo when it is imported, as it reads the choice of OpenGL at its import.
"""

from __future__ import annotations

from collections.abc import Iterator
import os
from pathlib import Path
import shutil
import subprocess
import sys
from typing import Any, TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from redundant_planner.physics import PhysicsError

if TYPE_CHECKING:
    import mujoco

Image = npt.NDArray[np.uint8]

_RATE = 20  # pictures a second
_WIDTH, _HEIGHT, _DPI = 640, 480, 80
# A film ends after this many pictures: one minute.
_MOST = 60 * _RATE
_TRIAL = 'import mujoco; mujoco.GLContext(16, 16)'
_TRIAL_PATIENCE = 30.0
# Where the camera stands: around the arm and above [degrees], and its distance in arm sizes.
_AZIMUTH, _ELEVATION, _DISTANCE = 130.0, -18.0, 1.5


def choose_gl() -> str:
    """Set MUJOCO_GL to an OpenGL that draws offscreen here; return its name.

    Each candidate is tried in a process of its own, as one that is missing may end it. Call this
    before MuJoCo is imported.

    Raises:
        PhysicsError: there is none.
    """
    chosen = os.environ.get('MUJOCO_GL')
    reasons = []
    for name in [chosen] if chosen else ['egl', 'osmesa']:
        try:
            trial = subprocess.run(
                [sys.executable, '-c', _TRIAL], env=dict(os.environ, MUJOCO_GL=name),
                capture_output=True, text=True, timeout=_TRIAL_PATIENCE)
        except subprocess.TimeoutExpired:
            reasons.append(f'{name}: no answer')
            continue
        if trial.returncode == 0:
            os.environ['MUJOCO_GL'] = name
            return name
        lines = trial.stderr.strip().splitlines()
        reasons.append(f'{name}: {lines[-1] if lines else f"exit status {trial.returncode}"}')
    raise PhysicsError(f'no OpenGL draws offscreen here ({"; ".join(reasons)})')


def check_file(path: Path) -> None:
    """Make sure that a film can be written to a file of this name.

    Raises:
        PhysicsError: it cannot, with the reason.
    """
    if path.suffix not in ('.gif', '.mp4'):
        raise PhysicsError(f"'{path}' is neither .gif nor .mp4")
    if path.suffix == '.mp4' and shutil.which('ffmpeg') is None:
        raise PhysicsError(f"'{path}' takes the command ffmpeg, which is not installed; a .gif "
                           'needs none')
    if not path.resolve().parent.is_dir():
        raise PhysicsError(f"'{path}' lies in a folder that does not exist")


class Film:
    """Keeps what is needed to draw a motion, and draws it in the end."""

    def __init__(self, path: Path, model: mujoco.MjModel) -> None:
        """Begin without pictures.

        Args:
            path: .gif or .mp4 file to write.
            model: that moves; its obstacles may change shape meanwhile.
        """
        self._path, self._model = path, model
        self._moments: list[tuple[npt.NDArray[Any], ...]] = []
        self._next = -np.inf

    def note(self, data: mujoco.MjData) -> None:
        """Keep this moment if the next picture is due."""
        if data.time < self._next or len(self._moments) == _MOST:
            return
        self._next = data.time + 1.0 / _RATE
        model = self._model
        self._moments.append(tuple(np.array(part) for part in (
            data.qpos, data.mocap_pos, data.mocap_quat, model.geom_type, model.geom_size,
            model.geom_rgba, model.geom_rbound)))

    def write(self) -> int:
        """Draw and write the film; return its number of pictures.

        Raises:
            PhysicsError: it cannot be drawn or written.
        """
        if not self._moments:
            return 0
        try:
            _write(self._path, self._pictures())
        except Exception as error:  # OpenGL's come in all kinds
            said = getattr(error, 'stderr', None) or error
            raise PhysicsError(f"'{self._path}': {said}") from None
        return len(self._moments)

    def _pictures(self) -> Iterator[Image]:
        import mujoco
        model, data = self._model, mujoco.MjData(self._model)
        model.vis.global_.offwidth, model.vis.global_.offheight = _WIDTH, _HEIGHT
        camera = mujoco.MjvCamera()
        camera.lookat[:], camera.distance = model.stat.center, _DISTANCE * model.stat.extent
        camera.azimuth, camera.elevation = _AZIMUTH, _ELEVATION
        renderer = mujoco.Renderer(model, _HEIGHT, _WIDTH)
        try:
            for moment in self._moments:
                (data.qpos[:], data.mocap_pos[:], data.mocap_quat[:], model.geom_type[:],
                 model.geom_size[:], model.geom_rgba[:], model.geom_rbound[:]) = moment
                mujoco.mj_forward(model, data)
                renderer.update_scene(data, camera)
                yield renderer.render()
        finally:
            renderer.close()


def _write(path: Path, pictures: Iterator[Image]) -> None:
    """Write a film; matplotlib's writers call Pillow for .gif and ffmpeg for .mp4."""
    from matplotlib.animation import FFMpegWriter, PillowWriter
    from matplotlib.figure import Figure
    figure = Figure(figsize=(_WIDTH / _DPI, _HEIGHT / _DPI), dpi=_DPI)
    writer = (PillowWriter if path.suffix == '.gif' else FFMpegWriter)(fps=_RATE)
    shown = None
    with writer.saving(figure, str(path), _DPI):
        for picture in pictures:
            if shown is None:
                shown = figure.figimage(picture)
            shown.set_data(picture)
            writer.grab_frame()
