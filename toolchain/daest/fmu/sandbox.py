"""The walls around the process that runs an FMU, which is foreign code with the user's rights.

On Linux the process gives up, before it loads the binary, to write outside its own folder, to open sockets,
to start processes, to signal or trace others, and to lift its limits: by Landlock (landlock(7)) and a filter
of system calls (seccomp(2)), as far as the kernel has them. Elsewhere, and where DAEST_FMU_SANDBOX is `off`,
its environment is scrubbed and its processes are ended, and nothing more.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import platform
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from daest.errors import FmuError

VARIABLE, PASS_VARIABLE = "DAEST_FMU_SANDBOX", "DAEST_FMU_PASS"
MODES = ("on", "off", "require")
# Variables that programs need to run; an FMU sees no others, unless DAEST_FMU_PASS names them.
_PASSED = (
    *("PATH", "LANG", "LC_ALL", "LC_CTYPE", "TZ", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH", "SYSTEMROOT"),
    *("SYSTEMDRIVE", "WINDIR", "COMSPEC", "PATHEXT", "NUMBER_OF_PROCESSORS", "PROCESSOR_ARCHITECTURE"),
)


@dataclass(frozen=True)
class Walls:
    """What an FMU cannot do: `write` outside its folder, open `tcp` connections or any `socket`, start
    `processes`, send `signals` to others."""

    write: bool = False
    tcp: bool = False
    socket: bool = False
    processes: bool = False
    signals: bool = False

    @property
    def are_whole(self) -> bool:
        return self.write and self.socket and self.processes and self.signals

    def sentence(self) -> str:
        """What holds, for a reader."""
        held = {
            "write outside its own folder": self.write,
            "open a socket": self.socket,
            "open a TCP connection": self.tcp and not self.socket,
            "start a process": self.processes,
            "signal another process": self.signals,
        }
        cannot = [what for what, is_held in held.items() if is_held]
        if not cannot:
            return "an FMU is not confined here: it can do what you can do; its environment alone is scrubbed"
        missing = [] if self.are_whole else [what for what in NEEDED if not held[what]]
        rest = f"; this kernel does not keep it from these: {', '.join(missing)}" if missing else ""
        return f"an FMU runs confined: it cannot {', '.join(cannot)}{rest}"


NEEDED = (
    "write outside its own folder",
    "open a socket",
    "start a process",
    "signal another process",
)


def chosen_mode() -> str:
    """What DAEST_FMU_SANDBOX says: `on` (as far as the kernel can, the default), `off`, or `require` (no FMU
    runs without all walls). FmuError `fmu-sandbox`."""
    mode = os.environ.get(VARIABLE) or MODES[0]
    if mode not in MODES:
        raise FmuError(
            "fmu-sandbox",
            f"{VARIABLE} is `{mode}`.",
            remedy=f"Write one of {', '.join(MODES)}, or leave it out.",
        )
    return mode


def scrubbed(folder: Path, more: Mapping[str, str]) -> dict[str, str]:
    """The environment of an FMU: what programs need to run, `folder` as home and for temporary files, `more`,
    and what DAEST_FMU_PASS names."""
    names = {*_PASSED, *filter(None, os.environ.get(PASS_VARIABLE, "").replace(",", " ").split())}
    passed = {name: value for name, value in os.environ.items() if name in names}
    places = dict.fromkeys(("HOME", "TMPDIR", "TEMP", "TMP", "USERPROFILE"), str(folder))
    return {**places, **passed, **more}


def confine(folder: Path) -> Walls:
    """Build the walls around this process, for good; only below `folder` it may write. To be called before
    there are threads. What the kernel does not have is left out, and told."""
    if sys.platform != "linux":
        return Walls()
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0) != 0:
        return Walls()
    _drop_capabilities(libc)
    landlock = _landlock(libc, folder)
    is_filtered = _filter(libc)
    return Walls(landlock >= 3, landlock >= 4, is_filtered, is_filtered, is_filtered or landlock >= 6)


def tried_walls() -> Walls:
    """What holds on this machine, tried out by a process of its own."""
    done = subprocess.run(
        [sys.executable, "-m", __name__], capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )  # fmt: skip
    with contextlib.suppress(ValueError):
        return Walls(**json.loads(done.stdout))
    return Walls()


def end_marked(mark: str) -> None:
    """End the processes that were started with the text `mark` in their environment: what an FMU left behind
    where it could start any. Linux."""
    own = os.getpid()
    for _ in range(20):  # they may start others meanwhile
        found = [pid for pid in _pids() if pid != own and mark.encode() in _environment(pid)]
        if not found:
            return
        for pid in found:
            with contextlib.suppress(OSError):
                os.kill(pid, signal.SIGKILL)


def _pids() -> list[int]:
    with contextlib.suppress(OSError):
        return [int(name) for name in os.listdir("/proc") if name.isdigit()]
    return []


def _environment(pid: int) -> bytes:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/environ").read_bytes()
    return b""


# Landlock ---------------------------------------------------------------------------------------------------

_NO_NEW_PRIVILEGES, _SECCOMP = 38, 22  # of prctl
_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446  # system calls, the same on all processors
_VERSION_FLAG, _PATH_BENEATH = 1, 1
# Bits of rights: writing to files, removing and making (4 to 12), renaming across folders (version 2),
# truncating (3), commands to devices (5).
_WRITE, _MAKE = 1 << 1, sum(1 << n for n in range(4, 13))
_REFER, _TRUNCATE, _IOCTL = 1 << 13, 1 << 14, 1 << 15
_DEVICES = 1 << 6 | 1 << 11
_NET, _SCOPES = 0b11, 0b11  # binding and connecting; abstract sockets and signals


def _landlock(libc: ctypes.CDLL, folder: Path) -> int:
    """The version of Landlock that keeps this process from writing anywhere but below `folder`; 0: none."""
    version = libc.syscall(_CREATE_RULESET, None, 0, _VERSION_FLAG)
    if version < 1:
        return 0
    rights = _WRITE | _MAKE | sum(r for r, v in ((_REFER, 2), (_TRUNCATE, 3), (_IOCTL, 5)) if version >= v)
    attribute = struct.pack("<QQQ", rights, _NET, _SCOPES)[: 8 if version < 4 else 16 if version < 6 else 24]
    ruleset = libc.syscall(_CREATE_RULESET, attribute, ctypes.c_size_t(len(attribute)), 0)
    if ruleset < 0:
        return 0
    try:
        _allow(libc, ruleset, str(folder), rights & ~_DEVICES)
        _allow(libc, ruleset, os.devnull, rights & (_WRITE | _TRUNCATE | _IOCTL))
        return version if libc.syscall(_RESTRICT_SELF, ruleset, 0) == 0 else 0
    finally:
        os.close(ruleset)


def _allow(libc: ctypes.CDLL, ruleset: int, place: str, rights: int) -> None:
    opened = os.open(place, os.O_PATH | os.O_CLOEXEC)
    libc.syscall(_ADD_RULE, ruleset, _PATH_BENEATH, struct.pack("<Qi", rights, opened), 0)
    os.close(opened)


def _drop_capabilities(libc: ctypes.CDLL) -> None:
    """What root can do beyond the rights of its files."""
    header = struct.pack("<Ii", 0x20080522, 0)
    libc.capset(header, bytes(24))


# Filter of system calls -------------------------------------------------------------------------------------

# Numbers on x86-64 and on ARM64 (None: there is no such call).
_REFUSED = {
    "socket": (41, 198), "fork": (57, None), "vfork": (58, None), "ptrace": (101, 117),
    "process_vm_readv": (310, 270), "process_vm_writev": (311, 271), "io_uring_setup": (425, 425),
    "tkill": (200, 130), "rt_sigqueueinfo": (129, 138), "rt_tgsigqueueinfo": (297, 240),
    "pidfd_send_signal": (424, 424), "pidfd_getfd": (438, 438), "setrlimit": (160, 164),
    # What Landlock does not know: owners, modes, times and attributes of files.
    "chmod": (90, None), "fchmod": (91, 52), "fchmodat": (268, 53), "fchmodat2": (452, 452),
    "chown": (92, None), "lchown": (94, None), "fchown": (93, 55), "fchownat": (260, 54),
    "utime": (132, None), "utimes": (235, None), "futimesat": (261, None), "utimensat": (280, 88),
    "setxattr": (188, 5), "lsetxattr": (189, 6), "fsetxattr": (190, 7), "removexattr": (197, 14),
    "lremovexattr": (198, 15), "fremovexattr": (199, 16),
    # The machine as a whole.
    "unshare": (272, 97), "setns": (308, 268), "mount": (165, 40), "init_module": (175, 105),
    "finit_module": (313, 273), "reboot": (169, 142), "kexec_load": (246, 104), "bpf": (321, 280),
    "perf_event_open": (298, 241), "settimeofday": (164, 170), "clock_settime": (227, 112),
    "adjtimex": (159, 171), "sethostname": (170, 161), "msgget": (68, 186), "semget": (64, 190),
    "shmget": (29, 194), "setpriority": (141, 140),
}  # fmt: skip
_CLONE, _CLONE3, _KILL, _TGKILL, _PRCTL, _PRLIMIT = (
    (56, 220), (435, 435), (62, 129), (234, 131), (157, 167), (302, 261),
)  # fmt: skip
_ARCHITECTURES = {"x86_64": (0, 0xC000003E), "aarch64": (1, 0xC00000B7)}
_X32 = 0x40000000  # numbers of another interface of x86-64
_CLONE_THREAD, _SET_DEATH_SIGNAL = 0x00010000, 1
_ALLOW, _EPERM, _ENOSYS = 0x7FFF0000, 0x00050000 | 1, 0x00050000 | 38
_LOAD, _EQUAL, _AT_LEAST, _ANY_BIT, _RETURN = 0x20, 0x15, 0x35, 0x45, 0x06
_NUMBER, _ARCHITECTURE, _ARGUMENTS = 0, 4, 16  # offsets in what the filter sees


def _filter(libc: ctypes.CDLL) -> bool:
    """Refuse the calls; whether the kernel does."""
    found = _ARCHITECTURES.get(platform.machine())
    if found is None:
        return False
    program = b"".join(struct.pack("<HBBI", *line) for line in _program(*found, os.getpid()))
    buffer = ctypes.create_string_buffer(program, len(program))
    header = struct.pack("@HxxxxxxP", len(program) // 8, ctypes.addressof(buffer))
    return libc.prctl(_SECCOMP, 2, header, 0, 0) == 0


def _program(column: int, architecture: int, pid: int) -> list[tuple[int, int, int, int]]:
    """Lines (code, jump if so, jump if not, value) of the filter."""
    lines = [
        (_LOAD, 0, 0, _ARCHITECTURE),
        (_EQUAL, 1, 0, architecture),
        (_RETURN, 0, 0, _EPERM),
        (_LOAD, 0, 0, _NUMBER),
    ]
    if column == 0:
        lines += [(_AT_LEAST, 0, 1, _X32), (_RETURN, 0, 0, _EPERM)]
    for numbers in _REFUSED.values():
        if numbers[column] is not None:
            lines += [(_EQUAL, 0, 1, int(numbers[column] or 0)), (_RETURN, 0, 0, _EPERM)]
    lines += [(_EQUAL, 0, 1, _CLONE3[column]), (_RETURN, 0, 0, _ENOSYS)]  # clone is tried then
    first, third = _ARGUMENTS, _ARGUMENTS + 16
    for numbers, offset, test, value, is_allowed in (
        (_CLONE, first, _ANY_BIT, _CLONE_THREAD, True),
        (_KILL, first, _EQUAL, pid, True),
        (_TGKILL, first, _EQUAL, pid, True),
        (_PRCTL, first, _EQUAL, _SET_DEATH_SIGNAL, False),
        (_PRLIMIT, third, _EQUAL, 0, True),
    ):
        ends = (_ALLOW, _EPERM) if is_allowed else (_EPERM, _ALLOW)
        lines += [
            (_EQUAL, 0, 4, numbers[column]),
            (_LOAD, 0, 0, offset),
            (test, 0, 1, value),
            *((_RETURN, 0, 0, end) for end in ends),
        ]
    return [*lines, (_RETURN, 0, 0, _ALLOW)]


# Trying -----------------------------------------------------------------------------------------------------


def _try_out() -> Walls:
    """Confine this process, and try what it should not be able to do."""
    import tempfile

    with tempfile.TemporaryDirectory(prefix="daest-walls-") as outside:
        inside = Path(outside) / "inside"
        inside.mkdir()
        child = os.fork() if hasattr(os, "fork") else -1
        if child == 0:
            _tell(inside, Path(outside))
        if child > 0:
            os.waitpid(child, 0)
        with contextlib.suppress(OSError, ValueError):
            return Walls(**json.loads((inside / "told").read_text(encoding="utf-8")))
    return Walls()


def _tell(inside: Path, outside: Path) -> None:
    try:
        confine(inside)
        walls = {
            "write": _is_refused(lambda: (outside / "file").write_text("")),
            "tcp": _is_refused(lambda: socket.socket().bind(("127.0.0.1", 0))),
            "socket": _is_refused(lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM)),
            "signals": _is_refused(lambda: os.kill(os.getppid(), 0)),
            "processes": _is_refused(_fork),
        }
        (inside / "told").write_text(json.dumps(walls), encoding="utf-8")
    finally:
        os._exit(0)


def _fork() -> None:
    if os.fork() == 0:
        os._exit(0)


def _is_refused(work: object) -> bool:
    try:
        work()  # type: ignore[operator]
    except OSError:
        return True
    return False


if __name__ == "__main__":
    from dataclasses import asdict

    print(json.dumps(asdict(_try_out())))
