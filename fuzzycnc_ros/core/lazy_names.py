# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Public names of a package that are loaded when they are first used."""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def lazy_names(package: str, modules: Mapping[str, tuple[str, ...]]) -> Callable[[str], Any]:
    """Return a package's `__getattr__`, which loads a name from its module.

    Parameters
    ----------
    package : str
        Name of the package.
    modules : mapping of str to tuple of str
        Public names by module.  None may be called like a module: once that is imported, the
        name would mean the module.
    """
    owner = {name: module for module, names in modules.items() for name in names}

    def load(name: str) -> Any:
        if name not in owner:
            raise AttributeError(f'module {package!r} has no attribute {name!r}')
        return getattr(import_module(f'{package}.{owner[name]}'), name)

    return load
