"""Stand for a process of the command line that `warm` forks: hand over its place, pass signals on, end as it ends.

Run as ``python -I -S client.py SOCKET ARGUMENTS``; it imports little, so that a start is cheap.
"""

import json
import os
import signal
import socket
import sys

server = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
server.connect(sys.argv[1])
request = {"arguments": sys.argv[2:], "environment": dict(os.environ), "folder": os.getcwd()}
files = [1, 2]
if "PMI_FD" in os.environ:
    files.append(int(os.environ["PMI_FD"]))
for number in (signal.SIGTERM, signal.SIGINT):
    signal.signal(number, lambda sent, _: server.send(str(sent).encode()))
socket.send_fds(server, [json.dumps(request).encode()], files)
code = os.waitstatus_to_exitcode(int(server.recv(32) or b"9"))
if code < 0:
    if code != -signal.SIGKILL:
        signal.signal(-code, signal.SIG_DFL)
    os.kill(os.getpid(), -code)
sys.exit(code)
