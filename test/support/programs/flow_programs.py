# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Random programs with O-words and expressions, which end and which LinuxCNC accepts."""

from random import Random

_FUNCTIONS = ('ABS', 'COS', 'FIX', 'FUP', 'ROUND', 'SIN')
_BINARY = ('+', '-', '*', 'MOD', 'EQ', 'NE', 'GT', 'GE', 'LT', 'LE', 'AND', 'OR', 'XOR')
NUMBERED = (31, 32, 33)
NAMED = ('one', '_two words', 'three')


class FlowProgram:
    """Writes a program.

    Parameters
    ----------
    random : Random
        Decides everything.
    """

    def __init__(self, random: Random) -> None:
        self._random = random
        self._label = 100
        self._loop: list[tuple[str, int]] = []
        self._subroutines: list[str] = []
        self._lines: list[str] = []
        self._inside = False

    def text(self) -> str:
        """Return the program."""
        random = self._random
        self._lines = ['G21 G90 G17 G64 P0.01', 'F900']
        self._lines += [f'#{index} = {random.randint(-9, 9)}' for index in NUMBERED]
        self._lines.append('#<_two words> = 3')
        self._lines.append('G0 X0 Y0 Z0')
        for _ in range(random.randint(0, 2)):
            self._subroutine()
        self._names()
        self._body(depth=0, size=random.randint(3, 8))
        self._lines += ['G90', 'M2']
        if random.random() < 0.5:
            self._fanuc()
        return '\n'.join(self._lines) + '\n'

    def _names(self) -> None:
        self._lines.append(f'#<one> = {self._random.randint(0, 4)} #<three>=[1/[2+1]]')

    def _subroutine(self) -> None:
        name = self._random.choice(('<part {}>', '{}')).format(self._new())
        self._lines.append(f'o{name} sub (a part)')
        self._inside = True
        self._names()
        self._body(depth=1, size=self._random.randint(1, 5))
        if self._random.random() < 0.3:
            label = self._new()
            self._lines.append(f'o{label} if [{self._expression(2)}]')
            self._lines.append(f'o{name} return [{self._expression(1)}]')
            self._lines.append(f'o{label} endif')
            self._body(depth=1, size=1)
        value = f' [{self._expression(1)}]' if self._random.random() < 0.5 else ''
        self._lines.append(f'o{name} endsub{value}')
        self._inside = False
        self._subroutines.append(name)

    def _fanuc(self) -> None:
        """Call a subroutine behind the end with M98."""
        number = self._new()
        self._lines.insert(-2, f'M98 P{number} L{self._random.randint(1, 3)}')
        self._lines.append(f'O{number}')
        self._names()
        for _ in range(self._random.randint(1, 3)):
            self._move()
        self._lines.append('M99')

    def _new(self) -> int:
        self._label += 1
        return self._label

    def _body(self, depth: int, size: int) -> None:
        kinds = ['_move', '_move', '_move', '_set', '_feed', '_modes']
        if depth < 3:
            kinds += ['_if', '_while', '_do', '_repeat']
        if self._loop:
            kinds.append('_leave')
        if self._subroutines:
            kinds.append('_call')
        for _ in range(size):
            kind = self._random.choice(kinds)
            if kind in ('_if', '_while', '_do', '_repeat'):
                getattr(self, kind)(depth)
            else:
                getattr(self, kind)()

    # Expressions

    def _value(self) -> str:
        random = self._random
        kind = random.randrange(5)
        if kind == 0:
            return f'#{random.choice(NUMBERED)}'
        if kind == 1:
            return f'#<{random.choice(NAMED)}>'
        if kind == 2 and self._inside:
            return f'#{random.randint(1, 3)}'
        return random.choice((f'{random.randint(-20, 20)}', f'{random.uniform(-9, 9):.3f}'))

    def _expression(self, depth: int) -> str:
        random = self._random
        if depth == 0 or random.random() < 0.2:
            return self._value()
        left = self._expression(depth - 1)
        kind = random.randrange(8)
        if kind == 0:
            return f'{random.choice(_FUNCTIONS)}[{left}]'
        if kind == 1:
            return f'-[{left}]' if left[0] in '-+' else f'-{left}' if left[0] == '#' else left
        if kind == 2:
            return f'SQRT[ABS[{left}]]'
        if kind == 3:
            return f'ATAN[{left}]/[{self._expression(depth - 1)}]'
        if kind == 4:
            return f'[{left}] / {random.choice((2, 3, 0.5))}'
        if kind == 5:
            return f'[[{left}] MOD 7] ** 2'
        right = self._expression(depth - 1)
        operation = random.choice(_BINARY)
        if operation == 'MOD':
            right = '4'
        return f'{left} {operation} {right}'

    def _place(self) -> str:
        """A coordinate of a reasonable size."""
        if self._random.random() < 0.5:
            return f'{self._random.uniform(-30, 30):.2f}'
        return f'[[{self._expression(2)}] MOD 50]'

    # Statements

    def _move(self) -> None:
        random = self._random
        words = [random.choice(('G0', 'G1', 'G1', 'G1'))]
        words += [f'{axis}{self._place()}' for axis in random.sample('XYZ', random.randint(1, 3))]
        if random.random() < 0.3:
            words.append(self._feed_word())
        self._lines.append(random.choice((' ', '')).join(words))

    def _feed_word(self) -> str:
        if self._random.random() < 0.6:
            return f'F{self._random.randint(100, 2000)}'
        return f'F[100 + ABS[{self._expression(1)}] MOD 500]'

    def _feed(self) -> None:
        self._lines.append(self._feed_word())

    def _modes(self) -> None:
        self._lines.append(self._random.choice(('G90', 'G91', 'G91 G1 X1', '(nothing)', '')))

    def _set(self) -> None:
        random = self._random
        target = random.choice([f'#{index}' for index in NUMBERED] + [f'#<{n}>' for n in NAMED])
        # Values must not grow without bounds in loops.
        self._lines.append(f'{target} = [[{self._expression(2)}] MOD 100]')

    def _if(self, depth: int) -> None:
        label = self._new()
        self._lines.append(f'o{label} if [{self._expression(2)}]')
        self._body(depth + 1, self._random.randint(1, 3))
        if self._random.random() < 0.4:
            self._lines.append(f'O{label} elseif [{self._expression(2)}]')
            self._body(depth + 1, self._random.randint(1, 2))
        if self._random.random() < 0.5:
            self._lines.append(f'o{label} else')
            self._body(depth + 1, self._random.randint(1, 2))
        self._lines.append(f'o{label} endif')

    def _while(self, depth: int) -> None:
        label = self._new()
        counter = f'#<c{label}>'
        self._lines.append(f'{counter} = 0')
        self._lines.append(f'o{label} while [{counter} LT {self._random.randint(0, 4)}]')
        self._lines.append(f'{counter} = [{counter} + 1]')
        self._inner(depth, f'{label}')
        self._lines.append(f'o{label} endwhile')

    def _do(self, depth: int) -> None:
        label = self._new()
        counter = f'#<c{label}>'
        self._lines += [f'{counter} = 0', f'o{label} do', f'{counter} = [{counter} + 1]']
        self._inner(depth, f'{label}')
        self._lines.append(f'o{label} while [{counter} LT {self._random.randint(0, 4)}]')

    def _inner(self, depth: int, label: str) -> None:
        self._loop.append((label, depth))
        self._body(depth + 1, self._random.randint(1, 4))
        self._loop.pop()

    def _repeat(self, depth: int) -> None:
        label = self._new()
        self._lines.append(f'o{label} repeat [{self._random.randint(0, 3)}]')
        outer, self._loop = self._loop, []
        self._body(depth + 1, self._random.randint(1, 3))
        self._loop = outer
        self._lines.append(f'o{label} endrepeat')

    def _leave(self) -> None:
        """Leave a loop under a condition."""
        label = self._new()
        self._lines.append(f'o{label} if [{self._expression(2)}]')
        word = self._random.choice(('break', 'continue'))
        self._lines.append(f'  o{self._loop[-1][0]} {word}')
        self._lines.append(f'o{label} endif')

    def _call(self) -> None:
        name = self._random.choice(self._subroutines)
        arguments = ' '.join(f'[{self._expression(1)}]' for _ in range(self._random.randint(0, 3)))
        self._lines.append(f'o{name} call {arguments}')
        if self._random.random() < 0.3:
            self._lines.append('G1 X[[#<_value>] MOD 40]')
