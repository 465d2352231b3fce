"""The robot files of config/ describe the arms they name."""

from __future__ import annotations

from conftest import EXAMPLE_ROBOTS, make_panda, PANDA_URDF
import numpy as np
import pinocchio as pin


def distance_to_segment(points, start, end):
    along = end - start
    t = np.clip((points - start) @ along / max(along @ along, 1e-12), 0.0, 1.0)
    return np.linalg.norm(points - start - t[:, None] * along, axis=1)


def test_every_vertex_of_the_pandas_meshes_is_inside_a_capsule():
    model = pin.buildModelFromUrdf(str(PANDA_URDF))
    geometry = pin.buildGeomFromUrdf(model, str(PANDA_URDF), pin.GeometryType.COLLISION,
                                     package_dirs=[str(EXAMPLE_ROBOTS.parent.parent)])
    capsules = {}
    for capsule in make_panda().capsules:
        capsules.setdefault(capsule.frame, []).append(capsule)
    checked = 0
    for shape in geometry.geometryObjects:
        frame = model.frames[shape.parentFrame]
        if frame.name == 'panda_link0' or not hasattr(shape.geometry, 'vertices'):
            continue
        vertices = np.array(shape.geometry.vertices()) * np.array(shape.meshScale)
        to_link = frame.placement.inverse() * shape.placement
        vertices = vertices @ to_link.rotation.T + to_link.translation
        depth = np.min([distance_to_segment(vertices, c.start, c.end) - c.radius
                        for c in capsules[frame.name]], axis=0)
        assert depth.max() <= 0.0, f'{frame.name}: {1e3 * depth.max():.2f} mm outside'
        checked += 1
    assert checked >= 8
