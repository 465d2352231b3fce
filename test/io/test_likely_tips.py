"""Which links of a URDF with several arms are proposed as tips, and what is made of them."""

from __future__ import annotations

from conftest import EXAMPLE_ROBOTS, HANDS, two_handed_urdf
import pytest
import yaml

from redundant_planner.io.hand_openings import openings_of
from redundant_planner.io.likely_tips import likely_tips
from redundant_planner.io.robot_files import Robot
from redundant_planner.tools.show_robot import main as show_robot

TIAGO = EXAMPLE_ROBOTS / 'tiago_description' / 'robots' / 'tiago_dual.urdf'
BAXTER = EXAMPLE_ROBOTS / 'baxter_description' / 'urdf' / 'baxter.urdf'
SHARE = {
    TIAGO: ('hand_left_safety_box', 'hand_right_safety_box'),
    BAXTER: ('right_gripper_base_link', 'left_gripper_base_link'),
    # Its legs fork before its arms.
    EXAMPLE_ROBOTS / 'talos_data' / 'robots' / 'talos_full_v2.urdf': (
        'gripper_left_base_link', 'gripper_right_base_link'),
    # Fingers, legs of four joints, and one arm are none.
    EXAMPLE_ROBOTS / 'panda_description' / 'urdf' / 'panda.urdf': (),
    EXAMPLE_ROBOTS / 'allegro_hand_description' / 'urdf' / 'allegro_left_hand.urdf': (),
    EXAMPLE_ROBOTS / 'anymal_b_simple_description' / 'robots' / 'anymal-kinova.urdf': ()}


@pytest.mark.parametrize(('urdf', 'tips'), SHARE.items(), ids=[path.stem for path in SHARE])
def test_ends_of_arms_that_fork_are_proposed(urdf, tips):
    assert likely_tips(urdf.read_text()) == tips


def test_chains_as_short_as_fingers_are_no_arms():
    assert likely_tips(two_handed_urdf()) == HANDS
    assert likely_tips(two_handed_urdf(lengths=(0.03, 0.03, 0.02))) == ()


def test_show_robot_proposes_tips_and_writes_a_file_for_them(tmp_path, capsys):
    file, picture = tmp_path / 'body.urdf', tmp_path / 'body.png'
    file.write_text(two_handed_urdf().replace('<link name="left_hand"/>', """<link
        name="left_hand"><collision><geometry><sphere radius="0.04"/></geometry></collision>
        </link>""").replace('<link name="right_hand"/>', """<link name="right_hand"><collision>
        <geometry><sphere radius="0.04"/></geometry></collision></link>"""))
    arguments = ['--urdf', str(file), '--out', str(picture)]
    assert show_robot(arguments) == 0
    said = ' '.join(capsys.readouterr().err.split())
    assert 'the URDF has 2 arms' in said and '--tips left_hand right_hand' in said
    assert show_robot([*arguments, '--tips', *HANDS]) == 0
    found = capsys.readouterr()
    assert 'has 2 arms' not in found.err and picture.exists()
    values = yaml.safe_load(found.out)['/**']['ros__parameters']
    assert values['tips'] == list(HANDS) and 'tip_frame' not in values
    assert len(values['initial_joints']) == 14
    written = tmp_path / 'body.yaml'
    written.write_text(found.out)
    assert Robot.from_file(written).tips == HANDS
    assert show_robot([*arguments, '--tip', 'left_hand', '--tips', *HANDS]) == 2
    assert 'give --tip or --tips, not both' in capsys.readouterr().err
    assert show_robot([*arguments, '--tips', 'left_hand', 'claw']) == 2
    assert "'claw' is not in the URDF" in capsys.readouterr().err


@pytest.mark.long
def test_the_fingers_of_both_hands_count_for_the_capsules():
    robot = Robot.from_urdf(TIAGO, tips=('arm_left_tool_link', 'arm_right_tool_link'))
    assert {'arm_left_tool_link', 'arm_right_tool_link'} <= {c.frame for c in robot.capsules}
    joints = openings_of(robot, {}).joints
    for side in ('left', 'right'):
        assert f'hand_{side}_little_flex_3_joint' in joints
