#!/usr/bin/env bash
# clang-tidy for one C++ source, unless it passed before with all that it includes as it is now: takes half a minute a file.
# What passed is remembered by its hash in the user's cache folder, for every clone of this repository.
set -euo pipefail
cd "$(dirname "$0")/.."
source=$1
passed=${XDG_CACHE_HOME:-$HOME/.cache}/armsight/clang-tidy

command=$(.venv/bin/python - "$PWD/$source" <<'PYTHON'
import json, pathlib, sys
for entry in json.loads(pathlib.Path("build/vision/compile_commands.json").read_text()):
    if entry["file"] == sys.argv[1]:
        print(entry["command"].rsplit(" -o ", 1)[0])
        break
else:
    sys.exit(f"{sys.argv[1]} is in no build: add it to a CMakeLists.txt")
PYTHON
)
# all of its text, wherever this clone lies, and what judges it
hash=$({
    (cd build/vision && $command -E -C -P "$OLDPWD/$source")
    cat "$source" services/vision_cpp/.clang-tidy tools/tidy.sh
    .venv/bin/clang-tidy --version
} | sed "s#$PWD##g" | sha256sum | cut -d ' ' -f 1)
[ ! -e "$passed/$hash" ] || exit 0
.venv/bin/clang-tidy --quiet -p build/vision "$source"
mkdir -p "$passed"
touch "$passed/$hash"
