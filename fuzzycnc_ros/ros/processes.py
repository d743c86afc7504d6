# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Processes of nodes and commands: the middleware's environment, and how they end.

They end by a signal, whatever they inherited, and with their parent.  No ROS is imported, so that
the environment can be set before rclpy is.
"""

import ctypes
import os
import resource
import signal
import stat
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from types import FrameType
from typing import NoReturn

from fuzzycnc_ros.files.uninterrupted import Interrupted, interrupt

DISCOVERY_PROFILE = Path(__file__).with_name('quick_discovery.xml')


RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
CHOSEN = (RANGE, 'ROS_LOCALHOST_ONLY', 'ROS_STATIC_PEERS', 'ROS_DISCOVERY_SERVER')
"""With any of these somebody has said who may find whom."""

DOMAIN_MAX = 232
"""Highest ROS domain that has ports; from 102 on they lie among those that Linux hands out."""


def prepare_environment() -> None:
    """Choose quick discovery, and on this host alone, unless the user has chosen otherwise.

    A graph that moves a machine must not be open to a whole network by accident.

    Raises
    ------
    ValueError
        If `ROS_DOMAIN_ID` is no domain, or `ROS_LOG_DIR` cannot be written: the middleware would
        take another one, or say why not in its own words.
    """
    domain = os.environ.get('ROS_DOMAIN_ID', '').strip()
    if domain and not (domain.isascii() and domain.isdigit() and int(domain) <= DOMAIN_MAX):
        raise ValueError(
            f'ROS_DOMAIN_ID: expected a whole number from 0 to 101 (at most {DOMAIN_MAX}) but '
            f'found {domain!r}: set one that your shop uses, or unset it for 0'
        )
    _choose_log_folder()
    os.environ.setdefault('FASTRTPS_DEFAULT_PROFILES_FILE', str(DISCOVERY_PROFILE))
    if not any(os.environ.get(name) for name in CHOSEN):
        os.environ[RANGE] = 'LOCALHOST'


def _choose_log_folder() -> None:
    """Have ROS write its logs into a temporary folder where it may not write into the home folder.

    Raises
    ------
    ValueError
        If the folder that somebody has chosen cannot be written.
    """
    chosen = os.environ.get('ROS_LOG_DIR', '')
    home = os.environ.get('ROS_HOME') or '~/.ros'
    folder = Path(chosen) if chosen else Path(home, 'log')
    with suppress(RuntimeError):  # a home folder that nobody has
        folder = folder.expanduser()
    there = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if there.is_dir() and os.access(there, os.W_OK | os.X_OK):
        return
    if chosen:
        raise ValueError(
            f'ROS_LOG_DIR: expected a folder that can be written but found {chosen}; name '
            'another one, or unset it'
        )
    own = Path(tempfile.gettempdir(), f'fuzzycnc-log-{os.geteuid()}')
    with suppress(FileExistsError):
        own.mkdir(mode=0o700)
    status = own.lstat()
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.geteuid():  # somebody else's
        own = Path(tempfile.mkdtemp(prefix='fuzzycnc-log-'))
    os.environ['ROS_LOG_DIR'] = str(own)


def open_to_network() -> None:
    """Let hosts of the same network find the graph, unless the user has chosen otherwise."""
    if not any(os.environ.get(name) for name in CHOSEN):
        os.environ[RANGE] = 'SUBNET'


WISHES = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that ask a process to end; the last one says that its terminal is gone."""
REFUSED = 2
"""Exit code of a node that refuses its parameters: to start it again would be in vain."""
ONE_WISH = 1.0
"""Wall time [s] within which signals are one wish: some senders signal a process and its group."""
HANGS = 3.0
"""Wall time [s] after which a wish that was put off is raised all the same."""
EXITING = 3
"""Wall time [s] that the interpreter and libraries have for what they do at the process' exit."""
AGAIN = 0.01
"""Wall time [s] after which a wish is repeated that was lost."""
_PR_SET_PDEATHSIG = 1
_SIGEV_THREAD = 2


class _Value(ctypes.Union):
    """Argument of a timer's function, `union sigval` of POSIX."""

    _fields_ = (('number', ctypes.c_int), ('pointer', ctypes.c_void_p))


class _Event(ctypes.Structure):
    """Notification of a timer that has run out, `struct sigevent` of Linux."""

    _fields_ = (
        ('value', _Value),
        ('signal', ctypes.c_int),
        ('notify', ctypes.c_int),
        ('function', ctypes.c_void_p),
        ('attributes', ctypes.c_void_p),
        ('padding', ctypes.c_byte * 32),
    )


class _Times(ctypes.Structure):
    """Times of a timer, `struct itimerspec`: two times in seconds and nanoseconds."""

    _fields_ = (('interval', ctypes.c_long * 2), ('value', ctypes.c_long * 2))


@contextmanager
def ending_within(seconds: int, code: int) -> Iterator[None]:
    """Have this process end unless the body is through in time, whatever it hangs in.

    Middleware that lets go of its peers while these end, too, was seen to spin forever, and it
    holds the interpreter meanwhile: neither a thread of Python nor a signal handler of Python is
    heard.  So the timer is the kernel's, and what it calls is `_exit`.

    Parameters
    ----------
    seconds : int
        Wall time from now [s].
    code : int
        What the process ends with then.
    """
    disarm = _end_after(seconds, code)
    try:
        yield
    finally:
        disarm()


def _end_after(seconds: int, code: int) -> Callable[[], object]:
    """Have the kernel end this process after a time [s]; return what takes that back."""
    library = ctypes.CDLL(None, use_errno=True)
    if not hasattr(library, 'timer_create'):  # glibc before 2.34 has it elsewhere
        return lambda: None
    event = _Event(
        notify=_SIGEV_THREAD, function=ctypes.cast(library._exit, ctypes.c_void_p).value
    )
    event.value.number = code
    timer = ctypes.c_void_p()
    times = _Times(value=(seconds, 0))
    if library.timer_create(time.CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(timer)):
        return lambda: None
    library.timer_settime(timer, 0, ctypes.byref(times), None)
    return partial(library.timer_delete, timer)


class StopRequest:
    """Request to end, as this process has received it.

    Attributes
    ----------
    number : int
        Signal that asked it first to end; 0 if none has.
    """

    def __init__(self) -> None:
        self.number = 0
        self._heard_at = -ONE_WISH
        self._repeating = self._lost = False
        self._put_off = False
        self._reminder: threading.Timer | None = None

    @contextmanager
    def put_off(self) -> Iterator[None]:
        """Raise no wish in the block, which looks at `number` itself, unless it hangs.

        Middleware calls into Python, to make a message for instance, where an exception ends up as
        another one, or as none.
        """
        self._put_off = True
        try:
            yield
        finally:
            self._put_off = False
            if self._reminder is not None:
                self._reminder.cancel()

    def hear(self, number: int, frame: FrameType | None) -> None:
        """Take a signal."""
        if self._repeating:  # what is raised here would be lost as well
            self._lost = True
            return
        now = time.monotonic()
        again = now - self._heard_at < ONE_WISH
        self.number, self._heard_at = self.number or number, now
        if again:
            return
        if not self._put_off:
            interrupt()
            return
        self._put_off = False
        self._reminder = threading.Timer(HANGS, os.kill, (os.getpid(), number))
        self._reminder.daemon = True
        self._reminder.start()

    def hear_again(self, lost: 'sys.UnraisableHookArgs') -> bool:
        """Repeat a wish whose exception was lost where none can be raised, as in a finaliser."""
        if not issubclass(lost.exc_type, Interrupted):
            return False
        self._repeating = self._lost = True
        while self._lost:
            self._lost = False
            # From another thread: this one is still in the place where nothing can be raised.
            threading.Timer(AGAIN, os.kill, (os.getpid(), self.number)).start()
        self._heard_at = -ONE_WISH
        self._repeating = False
        return True


def heard_wishes() -> list[signal.Signals]:
    """Return the signals that this process heeds: `nohup` means that SIGHUP is none of them."""
    deaf = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    return [number for number in WISHES if not (deaf and number is signal.SIGHUP)]


@contextmanager
def interruptible() -> Iterator[StopRequest]:
    """Let the wishes to end raise `Interrupted`, a KeyboardInterrupt, in the main thread alone.

    A shell starts what runs in its background with SIGINT ignored, and a parent may hold signals
    back; Python takes both as they are.  That would leave nothing but SIGKILL to end a process.
    """
    wish = StopRequest()
    wishes = heard_wishes()
    before = {number: signal.signal(number, wish.hear) for number in wishes}
    mask = signal.pthread_sigmask(signal.SIG_UNBLOCK, wishes)
    tell_lost = sys.unraisablehook
    sys.unraisablehook = lambda lost: wish.hear_again(lost) or tell_lost(lost)
    try:
        yield wish
    finally:
        sys.unraisablehook = tell_lost
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number, handler in before.items():
            signal.signal(number, handler or signal.SIG_DFL)


def end(code: int) -> NoReturn:
    """End this process, which is through: a wish to end that comes now changes its code no more.

    Nor does middleware that hangs in what it does when the process exits.

    Raises
    ------
    SystemExit
        In any case.
    """
    for number in heard_wishes():
        signal.signal(number, signal.SIG_IGN)
    _end_after(EXITING, code)
    sys.exit(code)


def processor_time(process: int) -> float:
    """Return the processor time that a process has used so far [s].

    Raises
    ------
    OSError
        If there is none of this number.
    """
    stat = Path(f'/proc/{process}/stat').read_text(encoding='utf-8')
    fields = stat.rpartition(')')[2].split()  # the name before it may hold anything
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def memory_limit() -> float | None:
    """Return how much address space this process and its children may have [MB]; None: any."""
    most = resource.getrlimit(resource.RLIMIT_AS)[0]
    return None if most == resource.RLIM_INFINITY else most / 1e6


def child_set_up() -> Callable[[], None]:
    """Return what a child process does before it begins, as `preexec_fn`.

    Signals reach it from its first moment on, and the kernel ends it when this process, or the
    thread that starts it, is gone, even if that was killed (Linux).
    """
    parent, wishes = os.getpid(), heard_wishes()
    # Elsewhere a killed parent leaves its children running.
    tell_kernel = getattr(ctypes.CDLL(None), 'prctl', lambda *_: 0)

    def set_up() -> None:
        for number in wishes:
            signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, wishes)
        tell_kernel(_PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != parent:
            os._exit(128 + signal.SIGTERM)  # it went before the kernel was told

    return set_up
