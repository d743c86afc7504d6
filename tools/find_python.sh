#!/bin/sh
# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
# Print the first interpreter that can build the environment; else say what is missing.
# Usage: tools/find_python.sh [CANDIDATE...]
cd "$(dirname "$0")/.." || exit 1

asked=$*
if [ -z "$asked" ]; then
    # The interpreter of an environment that is there comes first: no rebuild without need.
    built=$(sed -n 's/^executable = //p' .venv/pyvenv.cfg 2>/dev/null)
    set -- $built python3.12 python3.11 python3 python3.13 python3.10
fi
problem=
for name in "$@"; do
    # A version manager leaves shims of versions that are not active: only a run tells, and a
    # version that was asked for by name is taken from its folder.
    candidates=$name
    if [ -n "$asked" ] && command -v pyenv >/dev/null; then
        candidates="$name $(pyenv whence --path "$name" 2>/dev/null)"
    fi
    for candidate in $candidates; do
        "$candidate" -c 'import sys' >/dev/null 2>&1 || continue
        if found=$("$candidate" tools/setup_env.py check 2>&1); then
            echo "$candidate"
            exit 0
        fi
        problem=${problem:-$found}
    done
done
if [ -z "$problem" ]; then
    problem="set-up: expected Python 3.10 to 3.13 but found none that runs as ${asked:-python3}: \
run \`apt-get install python3 python3-venv python3-dev\`"
fi
echo "$problem" >&2
exit 1
