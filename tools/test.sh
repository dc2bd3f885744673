#!/usr/bin/env bash
# Every test that fits into minutes. Those that need a Docker daemon or Chromium are left out, and said to be, where there
# is none; with ARMSIGHT_CI set they must run.
set -uo pipefail
cd "$(dirname "$0")/.."
bin=$PWD/.venv/bin
failed=()

check() { # check NAME COMMAND...
    local name=$1 started=$SECONDS
    shift
    echo "test: $name"
    "$@" || failed+=("$name")
    echo "test: $name took $((SECONDS - started)) s"
}

check "zenoh bridge (Rust)" cargo test --quiet --release --manifest-path services/vision_cpp/zenoh_bridge/Cargo.toml \
    --target-dir build/vision/cargo
check "vision (C++)" ctest --test-dir build/vision --output-on-failure
check "vision with sanitizers" tools/sanitize.sh
check "vision fuzzed" tools/fuzz.sh 20
for package in proto services/sim services/control services/operator; do
    check "$package" "$bin/pytest" -q -m "not long" "$package/tests"
done
check "integration" "$bin/pytest" -q -m "not long and not docker and not browser" tests
if [ -n "${ARMSIGHT_CI:-}" ]; then
    check "install a browser" tools/install-apt-packages.sh tools/apt-packages-browser.txt
fi
if command -v chromium >/dev/null || [ -n "${ARMSIGHT_CI:-}" ]; then
    check "browser" "$bin/pytest" -q -m "browser and not long" tests
else
    echo "test: left out what needs Chromium (tests marked browser): tools/install-apt-packages.sh" \
        "tools/apt-packages-browser.txt installs it"
fi
if docker info >/dev/null 2>&1 || [ -n "${ARMSIGHT_CI:-}" ]; then
    check "docker" "$bin/pytest" -q -m "docker and not long" tests
else
    echo "test: left out what needs a Docker daemon (tests marked docker): none is reachable here"
fi

if [ ${#failed[@]} -gt 0 ]; then
    printf 'failed: %s\n' "${failed[*]}" >&2
    exit 1
fi
echo "all tests passed"
