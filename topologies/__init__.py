"""Topologies: functions ``(agents, *, options)`` from ids to directed links (sender, receiver)."""
