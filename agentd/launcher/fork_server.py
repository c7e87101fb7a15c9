"""Fork server: a process that has imported what every daemon needs, and forks the daemons of a launcher.

A daemon that is forked starts some 0.4 s of processor time earlier than one that imports everything itself, and shares
the memory of the imported modules. The server has neither threads nor a Zenoh session, so that forking it is safe.

It is started as ``python -m agentd.launcher.fork_server DESCRIPTOR MODULE...`` with the descriptor of a Unix socket and
modules to import. A request on the socket is a JSON list of arguments of `agentd`, together with the descriptors of
standard input, output and error; the answer is the id of the daemon's process. The daemon is forked by a process that
ends at once: the launcher, which adopts the orphans among its descendants, becomes its parent.
"""

import gc
import importlib
import json
import os
import runpy
import socket
import sys

from setproctitle import setproctitle

NEEDED = ("agentd.cli", "agentd.daemon.daemon", "agentd.daemon.output", "agentd.daemon.runner", "agentd.operator_file")
REQUEST_MAX = 1 << 16  # bytes


def main() -> None:
    """Serve requests until the launcher closes the socket; in a daemon, run its command instead, and exit."""
    channel = socket.socket(fileno=int(sys.argv[1]))
    for name in (*NEEDED, *sys.argv[2:]):
        importlib.import_module(name)
    gc.collect()
    gc.freeze()  # the collector does not touch what is shared
    arguments = _serve(channel)
    if arguments is not None:
        setproctitle(" ".join([sys.executable, "-m", "agentd", *arguments]))
        sys.argv = ["agentd", *arguments]
        runpy.run_module("agentd", run_name="__main__", alter_sys=True)


def _serve(channel: socket.socket) -> list[str] | None:
    """Fork a daemon for each request; return its arguments in the daemon, and None in the server at the end."""
    with channel:
        while True:
            request, descriptors, _, _ = socket.recv_fds(channel, REQUEST_MAX, 3)
            if not request:
                return None
            pid = _fork_orphan()
            if pid == 0:
                os.setsid()  # Ctrl-C reaches the launcher alone
                for number, descriptor in enumerate(descriptors):
                    os.dup2(descriptor, number)
            for descriptor in descriptors:
                os.close(descriptor)
            if pid == 0:
                _open_streams()
                arguments: list[str] = json.loads(request)
                return arguments
            channel.sendall(b"%d\n" % pid)


def _open_streams() -> None:
    """Open standard input, output and error anew: the present streams know properties of the server's descriptors."""
    sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", 1, "utf-8", "backslashreplace", closefd=False)  # noqa: SIM115


def _fork_orphan() -> int:
    """Fork a process whose parent has ended; return 0 in that process, and its id in this one."""
    reading, writing = os.pipe()
    parent = os.fork()
    if parent == 0:
        pid = os.fork()
        if pid:
            os.write(writing, b"%d" % pid)
            os._exit(0)
        os.close(reading)
        os.close(writing)
        return 0
    os.close(writing)
    with os.fdopen(reading, "rb") as answer:
        pid = int(answer.read())  # up to the end of the parent
    os.waitpid(parent, 0)
    return pid


if __name__ == "__main__":
    main()
