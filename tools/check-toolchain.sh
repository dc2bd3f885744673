#!/usr/bin/env bash
# Says clearly what set-up can't install by itself: Python 3.11 or newer, and Rust 1.85 or newer.
set -euo pipefail

at_least() { # at_least HAVE WANT
    [ "$(printf '%s\n%s\n' "$2" "$1" | sort -V | head -n 1)" = "$2" ]
}

python=$(python3 -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null || echo 0)
if ! at_least "$python" 3.11; then
    echo "armsight needs Python 3.11 or newer as python3; found $python" >&2
    exit 1
fi
rust=$(cargo --version 2>/dev/null | cut -d ' ' -f 2 || true)
if ! at_least "${rust:-0}" 1.85; then
    echo "armsight needs cargo 1.85 or newer; found ${rust:-none}. Debian 13 has it as rustc-web and cargo-web," >&2
    echo "every Linux through rustup (rustup.rs)." >&2
    exit 1
fi
