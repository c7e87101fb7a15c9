"""A radio with time slots (TDMA): a message waits for a slot of its sender."""
from dcf_zenoh.faults.fault import Fault, Stage


class TimeSlots(Fault):
    """One message leaves in each slot of the sender; sender s has slot s mod count of each frame.

    Args:
        sender: Id of the sender of this link.
        slot: Length of a slot, s.
        count: Slots in a frame.
    """

    STAGE = Stage.QUEUE
    LOSES = False

    def __init__(self, sender: int, *, slot: float, count: int):
        if not slot > 0 or count < 1:
            raise ValueError(f"slot must be positive, in s, and count at least 1, not {slot} and {count}")
        self.slot = round(slot * 1e9)  # ns, as all times of messages
        self.frame = count * self.slot
        self.offset = sender % count * self.slot
        self.free = 0  # earliest instant for the next message, ns

    def apply(self, delivery, rng):
        """Delay the message until the next free slot of its sender begins."""
        ready = max(delivery.due, self.free)
        due = ready + (self.offset - ready) % self.frame
        self.free = due + 1
        return [delivery._replace(due=due)]
