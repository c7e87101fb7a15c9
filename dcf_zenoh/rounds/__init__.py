"""Rounds of messages within a control step: dialogue, sender, receiver, agreement on the end.

Does no I/O and knows no clock; imports the kinds' interfaces, faults and the mailbox, never the loop.
"""
