#!/bin/sh
# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
# Resolve requirements/*.in into hashed locks for every supported interpreter.  Versions that are
# locked already stay, if they can: `tools/lock.sh --upgrade` takes the newest of all.
set -e
cd "$(dirname "$0")/../requirements"
command -v uv >/dev/null || {
    echo 'lock: expected uv on the PATH but found none: run make setup, which brings it' >&2
    exit 1
}

upgrade=$1

lock() {
    cp "$1.txt" "$1.lock.txt"
    uv pip compile --quiet --universal --python-version "$2" --generate-hashes --no-annotate \
        --no-header ${upgrade:+"$upgrade"} ${3:+--constraint "$3"} --output-file "$1.lock.txt" "$1.in"
    {
        head -n 2 "$1.in"
        echo "# Made by \`make lock\` from $1.in; do not edit."
        cat "$1.lock.txt"
    } >"$1.txt.new"
    rm "$1.lock.txt"
    mv "$1.txt.new" "$1.txt"
}

lock uv 3.10
lock docs 3.10
lock environment 3.10 docs.txt  # both go into one environment
lock floor 3.12
