#!/usr/bin/env bash
# Vision's unit tests with address and undefined-behaviour sanitizers; all that needs no bus.
set -euo pipefail
cd "$(dirname "$0")/.."
[ -f build/sanitize/build.ninja ] || cmake -S services/vision_cpp -B build/sanitize -G Ninja \
    -DCMAKE_BUILD_TYPE=RelWithDebInfo -DARMSIGHT_SERVICE=OFF -DARMSIGHT_SANITIZE=address,undefined >/dev/null
cmake --build build/sanitize --target vision_test wire_test
ctest --test-dir build/sanitize --output-on-failure --parallel "$(nproc)" | tail -n 40
