"""The row of the filter that keeps an arm out of singularities."""

from __future__ import annotations

import math

from redundant_planner.core.constants import RobotConstants
from redundant_planner.core.kernels import kernel
from redundant_planner.core.redundancy.null_space import Decomposition
from redundant_planner.core.robot.jacobian import derivative_between
from redundant_planner.core.robot.kinematics import Kinematics
from redundant_planner.core.safety.barriers import Barriers, SINGULARITY

# The smallest singular value is looked at below this multiple of its margin.
_NEAR = 5.0
# A singular value of a smaller share in its gradient costs more time than it tells.
_COUNTS = 1e-4
# Within that share of the margin about 0 the sign of a singular value does not count.
_ROUNDING = 0.25


@kernel
def singularity_row(
    rows: Barriers, at: int, arm: Kinematics, parts: Decomposition, constants: RobotConstants,
    margin: float,
) -> int:
    """Write a row that keeps the singular values, where one is small; return the next row.

    It keeps s = (Σ 1/(σ_i² + ε²))^(−½), which is about √(σ² + ε²) where one value σ is small.
    With σ_i's directions u_i and v_i, ∂σ_i/∂q_k = uᵢᵀ (∂J/∂q_k) v_i, and ∂s/∂q_k =
    Σ_i s³ σ_i / (σ_i² + ε²)² ∂σ_i/∂q_k. The smallest value's own gradient jumps where two are
    equal, and in a singularity itself; an arm that moves along there would shake. That of s does
    not (docs/safety.md).
    """
    sigma, rounding = parts.singular_values, _ROUNDING * margin
    if margin == 0.0 or sigma[-1] > _NEAR * margin:
        return at
    squares, total = sigma * sigma + rounding * rounding, 0.0
    for i in range(len(sigma)):
        total += 1.0 / squares[i]
    mean = 1.0 / math.sqrt(total)
    for i in range(len(sigma)):
        share = mean ** 3 * sigma[i] / squares[i] ** 2
        if share > _COUNTS:
            rows.gradient[at] += share * derivative_between(
                parts.left[:, i].copy(), arm.tip_jacobian, constants.scaling * parts.right[i],
                arm.tip_rotations, constants.in_tool, constants.rows)
    rows.value[at] = max(mean - math.sqrt(margin * margin + rounding * rounding), 0.0)
    rows.kind[at] = SINGULARITY
    return at + 1
