# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Names of the fuzzy sets and the published rules, method sheet 002 section 3."""

RATIO_SETS = ('VLF', 'LF', 'MF', 'HF', 'VHF', 'VVHF', 'TF')
"""Names of the output's sets, from the lowest feed to the full one."""

CURVATURE_SETS = ('ZO', 'VS', 'S', 'M', 'B', 'VB')
"""Names of the curvature's sets."""

VARIATION_SETS = ('ZO', 'L', 'M', 'H', 'VH')
"""Names of the sets of the curvature ahead."""

# Rows by curvature, columns by the curvature ahead.  VVLF is no set of the output.
_RULES = (
    ('TF', 'TF', 'VVHF', 'VVHF', 'VVLF'),
    ('VVHF', 'VVHF', 'VHF', 'VHF', 'VVLF'),
    ('VHF', 'HF', 'HF', 'HF', 'MF'),
    ('HF', 'HF', 'MF', 'MF', 'MF'),
    ('MF', 'LF', 'LF', 'VLF', 'VLF'),
    ('VLF', 'VLF', 'VLF', 'VLF', 'VLF'),
)


def published_rules(vvlf: str = 'MF') -> tuple[tuple[str, ...], ...]:
    """Return the 30 rules of method sheet 002 section 3, by name.

    Parameters
    ----------
    vvlf : str
        Set of `RATIO_SETS` in place of the name VVLF in rules 25 and 26, which is none.

    Returns
    -------
    tuple of tuple of str
        Six rows by curvature, five columns by the curvature ahead.

    Raises
    ------
    ValueError
        If `vvlf` is no set of the output.
    """
    if vvlf not in RATIO_SETS:
        raise ValueError(f'vvlf: expected one of {", ".join(RATIO_SETS)}, but found {vvlf!r}')
    return tuple(tuple(vvlf if name == 'VVLF' else name for name in row) for row in _RULES)
