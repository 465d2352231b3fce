"""What mujoco_hardware_node says of itself and of contacts, as messages."""

from __future__ import annotations

from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

if TYPE_CHECKING:  # others read the messages without MuJoCo
    from redundant_planner.physics.arm import PhysicsArm

CONTACTS, TORQUE_SHARE, TORQUE_JOINT = (
    'contacts', 'largest torque asked for, as a share of its limit', 'joint of that share')


def state_message(
    name: str, arm: PhysicsArm, stamp: object, real_time_factor: float, missed: int,
) -> DiagnosticArray:
    """Return the entry of /diagnostics.

    Args:
        name: of the node.
        arm: that it simulates.
        stamp: of the message.
        real_time_factor: simulated time per real time lately.
        missed: periods in which an answer was waited for in vain.
    """
    contacts = arm.contacts.contacts
    touching = [f'{contact.link} to {contact.other}' for contact in contacts if contact.touching]
    worst = int(arm.largest_demand.argmax())
    status = DiagnosticStatus(name=f'{name}: physics', hardware_id=arm.name)
    if touching:
        status.level = DiagnosticStatus.ERROR
        status.message = f'touching: {", ".join(touching)}'
    elif contacts:
        status.level, status.message = DiagnosticStatus.WARN, 'there were contacts'
    else:
        status.level, status.message = DiagnosticStatus.OK, 'no contact so far'
    status.values = _values({
        CONTACTS: str(arm.contacts.count),
        'deepest contact [m]': f'{max((c.deepest for c in contacts), default=0.0):.6f}',
        TORQUE_SHARE: f'{arm.largest_demand[worst]:.4f}',
        TORQUE_JOINT: arm.ranges.names[worst],
        'torques [Nm, N]': ' '.join(f'{torque:.2f}' for torque in arm.torques),
        'real-time factor': f'{real_time_factor:.2f}',
        'obstacles': str(arm.obstacles),
        'steps': str(arm.steps),
        'answers missed': str(missed),
    })
    return _array([status], stamp)


def contacts_message(arm: PhysicsArm, stamp: object) -> DiagnosticArray:
    """Return ~/contacts: an entry for each link and what it has touched so far."""
    return _array([DiagnosticStatus(
        level=DiagnosticStatus.ERROR if contact.touching else DiagnosticStatus.WARN,
        name=f'{contact.link} to {contact.other}', hardware_id=arm.name,
        message='touching' if contact.touching else 'apart again',
        values=_values({
            'link': contact.link, 'other': contact.other, 'count': str(contact.times),
            'deepest [m]': f'{contact.deepest:.6f}', 'first [s]': f'{contact.first:.4f}',
            'last [s]': f'{contact.last:.4f}'})) for contact in arm.contacts.contacts], stamp)


def read_state(message: DiagnosticArray) -> dict[str, str] | None:
    """Return the values of such an entry of /diagnostics; None if the message has none."""
    for status in message.status:
        if status.name.endswith(': physics'):
            return {value.key: value.value for value in status.values}
    return None


def _values(entries: dict[str, str]) -> list[KeyValue]:
    return [KeyValue(key=key, value=value) for key, value in entries.items()]


def _array(statuses: list[DiagnosticStatus], stamp: object) -> DiagnosticArray:
    message = DiagnosticArray(status=statuses)
    message.header.stamp = stamp
    return message
