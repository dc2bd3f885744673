#!/usr/bin/env bash
# Fuzzes what vision reads from the bus for so many seconds a target (default 20), with address and undefined-behaviour
# sanitizers. What is found lies in build/fuzz/found; seeds are in services/vision_cpp/fuzz/corpus.
set -euo pipefail
cd "$(dirname "$0")/.."
seconds=${1:-20}

tools/install-apt-packages.sh tools/apt-packages-fuzz.txt
[ -f build/fuzz/build.ninja ] || cmake -S services/vision_cpp -B build/fuzz -G Ninja -DCMAKE_CXX_COMPILER=clang++ \
    -DCMAKE_BUILD_TYPE=RelWithDebInfo -DCMAKE_CXX_FLAGS_RELWITHDEBINFO="-O1 -g1 -DNDEBUG" \
    -DARMSIGHT_SERVICE=OFF -DARMSIGHT_TESTS=OFF -DARMSIGHT_FUZZ=ON \
    -DARMSIGHT_SANITIZE=address,undefined,fuzzer-no-link >/dev/null
cmake --build build/fuzz
mkdir -p build/fuzz/found
for target in image message; do
    mkdir -p "build/fuzz/corpus/$target"
    echo "fuzz: $target for $seconds s"
    build/fuzz/fuzz/${target}_fuzz -max_total_time="$seconds" -timeout=5 -rss_limit_mb=2048 -max_len=65536 \
        -print_final_stats=1 -verbosity=0 -artifact_prefix=build/fuzz/found/ \
        "build/fuzz/corpus/$target" "services/vision_cpp/fuzz/corpus/$target" 2>&1 \
        | { grep -vE '^(INFO|#|Running|Done)' || true; }
done
