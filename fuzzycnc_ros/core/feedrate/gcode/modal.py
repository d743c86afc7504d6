# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Modal state of a controller, and the words that it knows."""

from dataclasses import dataclass
from math import nan

MILLIMETRE = 1e-3
INCH = 25.4e-3
MINUTE = 60.0


def feed_decimals(unit: float) -> int:
    """Return the decimals that a feed word needs where a feed of 1 is so much [m/s].

    They are fine enough for 0.1 % of 1 mm/min; controllers take that many.
    """
    return 5 if unit == INCH / MINUTE else 3


def least_feed(unit: float) -> float:
    """Return the least feed that a word can say, in the unit of the program."""
    return float(10.0 ** -feed_decimals(unit))


# G words in tenths: 53 is G5.3.
MOTION = frozenset({0, 10, 20, 30, 52, 62})
"""Rapid, line, both arcs, and the NURBS blocks G5.2 and G6.2."""

CYCLES = frozenset({730, 740, 760, 810, 820, 830, 840, 850, 860, 870, 880, 890})
"""Fixed cycles: they move by themselves, in every line that follows."""

FRAMES = frozenset(
    {
        *(510, 500, 511, 501, 680, 690, 921, 922, 923, 520, 100, 101),
        *(681, 682, 683, 684, 685, 691, 531, 536, 542, 544),  # tilted planes, Fanuc
        *(2340, 2540, 2550, 2680, 2690),  # the same, Haas
    }
)
"""Scaling, rotation and shifts of the coordinates: where the tool stands in them is unknown."""

TRANSFORMED = {121: 131, 1120: 1130, 512: 502, 1370: 1360}
"""G words that bend the coordinates, such as polar interpolation, by those that end it."""

CYLINDERS = frozenset({71, 1070})
"""G7.1 and G107: coordinates on a cylinder of radius C (R of Haas); 0 or none ends them."""

TRANSFORM_NAMES = frozenset({'TRANSMIT', 'TRACYL'})
"""The same of Siemens' controllers."""

TRANSFORM_ENDS = frozenset({'TRAFOOF', 'TRAORI', 'TRAANG'})

PIVOTS = frozenset({433, 434, 435, 438, 439})
"""Tool lengths that go with the rotary axes: the coordinates are those of the tool's tip."""

OFFSETS = frozenset({540, 550, 560, 570, 580, 590, 591, 592, 593, 541, 1540, 5000})
OFFSETS |= {*range(5050, 6000, 10)} | {1100, 1110, *range(1140, 1300, 10)}
"""Work offsets: a change of them shifts the coordinates.  That of G54.1 and G154 is their P."""

CALLS = frozenset({650, 660, 661})
"""Calls of macros."""

SHARED = frozenset({120, 130, 200, 210, 700, 710, 711, 712, 720, 721, 722, 730, 750, 1500})
"""Words that are units, places or modes on one controller and cycles on another."""

_CONTOUR = frozenset('PQ')
_OWN_WORDS = frozenset('PQLRUWIJK')
_ARC_WORDS = frozenset('PRUWIJK')


def shared_meaning(codes: list[int], letters: set[str]) -> str:
    """Return what words that controllers share mean beside others.

    Parameters
    ----------
    codes : list of int
        G words of the line in tenths.
    letters : set of str
        Letters of all its words, and names to which it assigns.

    Returns
    -------
    str
        `pattern` of holes or a pocket (Haas: G70 I J L, G71, G72, G12, G13), `turning` cycle
        (P and Q of Fanuc, Q of LinuxCNC, the first line G71 U R), `home` (Okuma's G20 HP=);
        empty for a unit, a fixed cycle or whatever else the word is by itself.
    """
    shared = SHARED.intersection(codes)
    if shared & {200, 210}:
        return 'home' if 'HP' in letters else ''
    if shared & {120, 130, 1500}:
        return 'pattern'
    if 730 in shared:
        return 'turning' if letters >= _CONTOUR and letters.isdisjoint('XYZ') else ''
    if 750 in shared:
        return 'turning' if letters & _CONTOUR else ''
    own = _OWN_WORDS & letters
    if MOTION.intersection(codes):
        own -= _ARC_WORDS
    if not own or 40 in codes:  # P of a wait
        return ''
    return 'turning' if own & {*_CONTOUR, *'RUW'} else 'pattern'


TOOL_LENGTHS = frozenset({430, 431, 432, 440})

ELSEWHERE = frozenset({270, 280, 290, 300, 530, 1530, 382, 383, 384, 385, 750})
"""The axes that are named end at a place that the program does not say (references, probing)."""

HARMLESS = frozenset(
    {
        *(150, 400, 490, 600, 601, 610, 611, 640, 800, 940, 970, 960, 90),
        *(6010, 6020, 6030, 6410, 6420, 6430, 6440, 6450, 4500, 4510),
    }
)
"""No motion of their own: exact stop, path control, ends of cycles and of compensation."""

THREADS = frozenset({320, 330, 331, 340, 350, 360})
"""Threading: F is a pitch, and the words go on until another motion is named."""

BOXES = frozenset({900, 920, 940})
"""Cycles of Fanuc's lathes where an axis stands beside them: turning, threading, facing."""

CUTTER = frozenset({410, 411, 420, 421})
"""Cutter compensation: the tool runs beside the path that is programmed."""

DIAMETER = {70: (0.5, 0.5), 80: (1.0, 1.0)}
"""G7 and G8 of lathes: what share of an absolute and a relative X is a length along the axis."""

DIAMETER_NAMES = {'DIAMON': (0.5, 0.5), 'DIAM90': (0.5, 1.0), 'DIAMOF': (1.0, 1.0)}
"""The same of Siemens' controllers."""

PLANE = {170: 17, 180: 18, 190: 19}
LENGTH_UNIT = {200: INCH, 210: MILLIMETRE, 700: INCH, 710: MILLIMETRE}
LENGTH_UNIT |= {7000: INCH, 7100: MILLIMETRE}

FEED_UNITS = frozenset({200, 210, 7000, 7100})
"""Of the units those that count for the feed as well; G70 and G71 are for lengths only."""

EXACT = frozenset({610, 611})
"""Exact path and exact stop: no corner is rounded off."""

ROUNDS = frozenset({640, 6410, 6420, 6430, 6440, 6450})
"""Path control: G64 of LinuxCNC says in P how far corners may be rounded off."""

STOPS = frozenset({0, 1, 6, 60})
"""M words at which the tool stands still before the next block."""

ENDS = frozenset({2, 30})

PRINTER_M = frozenset({82, 83, 104, 109, 140, 190})
"""M words that 3D printers alone know: extruder modes and temperatures."""

MOVING_M = frozenset({125, 600, 701, 702})
"""M words of 3D printers that move axes."""

SHIFTING_M = frozenset({206, 290, 428, 665, 666})
"""M words of 3D printers that shift coordinates."""

MOVING_COMMANDS = ('$H', '$J')
"""Commands of GRBL that move axes begin so."""

KLIPPER = frozenset(
    'SET_VELOCITY_LIMIT SET_PRESSURE_ADVANCE SET_RETRACTION SET_PRINT_STATS_INFO SET_PIN '
    'SET_FAN_SPEED SET_HEATER_TEMPERATURE SET_LED SET_DISPLAY_TEXT SET_IDLE_TIMEOUT '
    'SET_INPUT_SHAPER SET_STEPPER_ENABLE SET_TMC_CURRENT SET_FILAMENT_SENSOR SET_GCODE_VARIABLE '
    'EXCLUDE_OBJECT EXCLUDE_OBJECT_DEFINE EXCLUDE_OBJECT_START EXCLUDE_OBJECT_END '
    'TEMPERATURE_WAIT TURN_OFF_HEATERS RESPOND UPDATE_DELAYED_GCODE TIMELAPSE_TAKE_FRAME '
    'BED_MESH_PROFILE SKEW_PROFILE SAVE_GCODE_STATE QUERY_ENDSTOPS STATUS PRESSURE_ADVANCE '
    '_TIMELAPSE_NEW_FRAME'.split()
)
"""Extended commands of Klipper that move nothing."""

# Names of Siemens controllers.
SILENT_NAMES = frozenset(
    'FNORM FLIN FCUB COMPOF COMPON COMPCURV COMPCAD COMPSURF BRISK SOFT DRIVE FFWON FFWOF '
    'ORIAXES ORIMKS ORIWKS ORIVECT ORIMACHAX UPATH SPATH STOPRE CFC CFTCP CFIN '
    'NORM KONT RTLION RTLIOF DYNNORM DYNPOS DYNROUGH DYNSEMIFIN DYNFINISH'.split()
)
"""Words that choose how the path is followed; its shape stays."""

SILENT_CALLS = frozenset({'MSG', 'CYCLE832', 'SETAL', 'WORKPIECE', 'GROUP_BEGIN', 'GROUP_END'})
"""Messages and settings."""

DECLARATIONS = frozenset({'DEF', 'PROC', 'EXTERN', 'MSG'})

FRAME_NAMES = frozenset(
    'TRANS ATRANS ROT AROT ROTS AROTS SCALE ASCALE MIRROR AMIRROR TRAFOOF TRAORI TRANSMIT '
    'TRACYL TRAANG TRACON TOROT TOROTOF TOFRAME TCARR PLANE FUNCTION TCPM'.split()
)
"""Turn or shift the coordinates; letters beside them are no motion."""

FRAME_M = frozenset({128, 129})
"""M words of Heidenhain after which the coordinates are those of the tool's tip, or not."""

MACHINE_NAMES = frozenset({'SUPA'})
"""The axes that are named move in the coordinates of the machine, in this block only."""

_SAVED = (
    *('plane', 'length_unit', 'feed_unit', 'unit_said', 'absolute', 'centre_absolute'),
    *('feed_mode', 'retracts', 'x_share'),
)


@dataclass
class Cycle:
    """A fixed cycle in effect, lengths in metres and None where the program does not say.

    Parameters
    ----------
    code : int
        Its G word in tenths.
    start : float
        Where the axis across the plane stood before the first one of a series.
    retract : float or None
        R as programmed, a relative one as such.
    """

    code: int
    start: float
    retract: float | None = None


class ModalState:
    """Modal state of a controller, and where the tool stands.

    Attributes
    ----------
    position : list of float
        X, Y and Z [m]; NaN where the program does not say.
    others : dict
        Positions of the other axes by letter, as programmed.
    motion : int or None
        Motion in effect as G word in tenths; None for none, -1 for a cycle.
    plane : int
        17, 18 or 19.
    length_unit, feed_unit : float
        What a length [m] and a feed [m/s] of 1 is.
    absolute, centre_absolute : bool
        G90 and G90.1.
    feed : float or None
        Feed in effect [m/s].
    feed_known : bool
        False while something that was passed through may have set the feed.
    feed_mode : int
        94: length per minute, 93: inverse time, 95: per revolution.
    cycle : Cycle or None
        Fixed cycle in effect.
    retracts : bool or None
        Cycles end at their R (G99) and not where they began (G98); None until it is said.
    unit_said : bool
        The program has said its unit.
    x_share : tuple of float, length 2
        Length along the axis per absolute and per relative X: a half where X is a diameter.
    assumed : set of str
        Those of X, Y and Z that have not been named: the origin as their place is assumed.
    cutter : bool
        Cutter compensation is in effect.
    offset : tuple or None
        Work offset in effect: its G word in tenths and, where it has one, its P.
    pivot : bool
        Coordinates are those of the tip of a tool whose direction I, J and K may say.
    printer : bool
        The program is for a 3D printer.
    lathe : bool
        The program is for a lathe of Fanuc's kind, see `Outline`.
    unnamed : str
        Axes that the program never names: nobody waits for their place.
    tool_length, polar, modal_call : bool
        A tool length is in effect; coordinates are polar; each position calls a cycle.
    transform : str
        What bends the coordinates, as text; empty for nothing.
    rounding : float or None
        How far corners may be rounded off [m], see `Block.rounding`.
    run : int
        Number of the run, see `Segment.run`.
    kind : str
        Kind of the last segment; empty where the next one starts a run.
    turns : int
        Full turns of all arcs so far, the first of each left out.
    percents : int
        How many lines `%` were met.
    ended : bool
        The program is over; nothing that follows is read.
    """

    __slots__ = (
        'absolute',
        'assumed',
        'centre_absolute',
        'cutter',
        'cycle',
        'ended',
        'feed',
        'feed_known',
        'feed_mode',
        'feed_unit',
        'kind',
        'lathe',
        'length_unit',
        'modal_call',
        'motion',
        'offset',
        'others',
        'percents',
        'pivot',
        'plane',
        'polar',
        'position',
        'printer',
        'retracts',
        'rounding',
        'run',
        'tool_length',
        'transform',
        'turns',
        'unit_said',
        'unnamed',
        'x_share',
    )

    def __init__(self, length_unit: float) -> None:
        self.position = [0.0, 0.0, 0.0]
        self.others: dict[str, float] = {}
        self.motion: int | None = None
        self.plane = 17
        self.length_unit = length_unit
        self.feed_unit = length_unit / MINUTE
        self.absolute = True
        self.centre_absolute = False
        self.feed: float | None = None
        self.feed_known = True
        self.feed_mode = 94
        self.cycle: Cycle | None = None
        self.retracts: bool | None = None
        self.unit_said = False
        self.x_share = (1.0, 1.0)
        self.assumed = set('XYZ')
        self.cutter = False
        self.offset: tuple[int, float | None] | None = None
        self.tool_length = False
        self.polar = False
        self.lathe = False
        self.unnamed = ''
        self.pivot = False
        self.printer = False
        self.transform = ''
        self.modal_call = False
        self.rounding: float | None = None
        self.run = 0
        self.kind = ''
        self.turns = 0
        self.percents = 0
        self.ended = False

    def length(self, axis: int, value: float, absolute: bool) -> float:
        """Return the length [m] along X, Y or Z that an absolute or a relative word means."""
        length = value * self.length_unit
        return length if axis else length * self.x_share[0 if absolute else 1]

    def set_lathe(self) -> None:
        """Take what lathes of Fanuc's kind have in effect when they are switched on."""
        self.lathe, self.plane, self.x_share = True, 18, (0.5, 0.5)
        self.feed_mode = 95

    def lose(self, axes: str = 'XYZ') -> None:
        """Forget where axes are; the next segment starts a run."""
        for axis in axes:
            if axis not in self.unnamed:
                self.position['XYZ'.index(axis)] = nan
        self.kind = ''

    def lose_feed(self) -> None:
        """Forget the feed: a subprogram may have set it."""
        self.feed = None
        self.feed_known = False

    def run_of(self, kind: str) -> int:
        """Return the run of a segment of this kind; a change of kind starts one."""
        if kind != self.kind:
            self.run += 1
            self.kind = kind
        return self.run

    def saved(self) -> dict[str, object]:
        """Return what M70 and M73 keep: modes, not places."""
        return {name: getattr(self, name) for name in _SAVED}

    def restore(self, saved: dict[str, object]) -> None:
        """Take back what `saved` returned; the feed is that which was in effect there, unknown."""
        for name, value in saved.items():
            setattr(self, name, value)
        self.lose_feed()
        self.kind = ''
