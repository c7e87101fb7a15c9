"""Transport of messages between agents: mailbox, handshake, Zenoh session."""
