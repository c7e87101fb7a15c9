"""Rounds of messages within a control step: dialogue, sender, receiver, agreement on the end, the two modes.

No I/O and no clock in here. Imports algorithms, faults and the mailbox, never the loop.
"""
