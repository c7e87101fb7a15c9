"""Who hears whom: functions ``(agents, *, options)`` from ids to directed links (sender, receiver)."""
