#!/usr/bin/env bash
# Vision's unit tests with sanitizers, all that needs no bus: addresses and undefined behaviour in every test, data races
# in the one that runs the service's threads. Optimised a little only: that compiles in half the time.
# Warnings are errors in every other build, not here: what sanitizers add makes GCC 12 warn of what is initialised.
set -euo pipefail
cd "$(dirname "$0")/.."

build() { # build FOLDER SANITIZERS TARGET...
    local folder=$1 sanitizers=$2
    shift 2
    [ -f "$folder/build.ninja" ] || cmake -S services/vision_cpp -B "$folder" -G Ninja \
        -DCMAKE_BUILD_TYPE=RelWithDebInfo -DCMAKE_CXX_FLAGS_RELWITHDEBINFO="-O1 -g1 -DNDEBUG" \
        -DARMSIGHT_SERVICE=OFF -DARMSIGHT_STRICT=OFF -DARMSIGHT_SANITIZE="$sanitizers" >/dev/null
    cmake --build "$folder" --target "$@"
}

build build/sanitize address,undefined vision_test wire_test threads_test
ctest --test-dir build/sanitize --output-on-failure --parallel "$(nproc)" | tail -n 40

build build/sanitize-threads thread threads_test
# GCC's thread sanitizer cannot start where addresses are random to 32 bits
fixed=()
if setarch --addr-no-randomize true 2>/dev/null; then fixed=(setarch --addr-no-randomize); fi
"${fixed[@]}" build/sanitize-threads/tests/threads_test
