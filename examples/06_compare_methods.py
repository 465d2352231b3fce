"""Compare the methods on one motion: python examples/06_compare_methods.py methods.png.

Without a file name the joints' curves are drawn in a window.
"""

import sys

import matplotlib

if len(sys.argv) > 1:
    matplotlib.use('Agg')  # draws without a screen
import matplotlib.pyplot as plt
import numpy as np

from redundant_planner import Obstacle, Planner, PlannerParameters, Preview, Robot, Scene, simulate
from redundant_planner.analysis.style import STYLE

robot = Robot.from_file('package://redundant_planner/config/robots/paper_2p5r.yaml')
scene = Scene.of([Obstacle('ball', center=[0.0, 0.55, 0.45], semi_axes=[0.05, 0.03, 0.03])])
start = [0.1, 0.1, 0.0, 0.52, -0.52, 1.05, 0.0]  # [m, rad]
twist = [-0.029, -0.05, 0.004, 0.0, 0.0, 0.0]  # [m/s, rad/s]
preview = Preview([0.0, 3.0], [twist, twist])

plt.rcParams.update(STYLE)
figure, axes = plt.subplots(2, 3, sharex=True, layout='constrained')
print('method               joint path  squared velocities  clearance')
for method in ('gradient_projection', 'dynamic_factor', 'variational'):
    motion = simulate(Planner(robot, PlannerParameters(method=method)), start, twist, scene,
                      duration=3.0, dt=0.004, preview=preview)
    path = np.abs(np.diff(motion.positions, axis=0)).sum()
    squared = np.square(motion.velocities).sum() * 0.004
    print(f'{method:20} {path:10.4f}  {squared:18.5f}  {1000 * motion.clearance.min():6.1f} mm')
    for joint, plot in enumerate(axes.flat):
        plot.plot(motion.times, motion.positions[:, joint] - start[joint], label=method)

for name, plot in zip(robot.joint_names, axes.flat):
    plot.set_title(name)
figure.legend(*axes[0, 0].get_legend_handles_labels(), loc='outside upper center', ncols=3)
figure.supxlabel('time [s]')
figure.supylabel('displacement [m, rad]')
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1])
else:
    plt.show()
