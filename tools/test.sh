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

beside() { # beside NAME COMMAND...: goes on while others are checked; what it says comes when it is waited for
    local name=$1
    shift
    echo "test: $name, beside the next"
    (
        started=$SECONDS
        "$@"
        code=$?
        echo "test: $name took $((SECONDS - started)) s"
        exit "$code"
    ) >"$logs/$name" 2>&1 &
    background[$name]=$!
}

await() { # await NAME...
    local name
    for name in "$@"; do
        [ -n "${background[$name]:-}" ] || continue
        wait "${background[$name]}" || failed+=("$name")
        echo "test: $name"
        cat "$logs/$name"
    done
}

declare -A background=()
logs=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null; rm -rf "$logs"' EXIT

# What waits for containers, and what runs in its own time, leaves the processors to others.
if docker info >/dev/null 2>&1 || [ -n "${ARMSIGHT_CI:-}" ]; then
    beside docker "$bin/pytest" -q -m "docker and not long" tests
else
    echo "test: left out what needs a Docker daemon (tests marked docker): none is reachable here"
fi
beside untimed nice -n 15 "$bin/pytest" -q --timeout 1800 -m "untimed and not long" tests # others come first
check "zenoh bridge (Rust)" cargo test --quiet --release --manifest-path services/vision_cpp/zenoh_bridge/Cargo.toml \
    --target-dir build/vision/cargo
check "vision (C++)" ctest --test-dir build/vision --output-on-failure
check "vision with sanitizers" tools/sanitize.sh
check "vision fuzzed" tools/fuzz.sh 20
check "proto" "$bin/pytest" -q -m "not long" proto/tests
check "services/sim" "$bin/pytest" -q -m "not long" services/sim/tests
check "services/camera" "$bin/pytest" -q -m "not long" services/camera/tests
# they mostly wait: for processes, and for what must not happen
check "services/control" "$bin/pytest" -q -m "not long" --numprocesses 2 --dist loadfile services/control/tests
check "services/operator" "$bin/pytest" -q -m "not long" --numprocesses 4 --dist loadfile services/operator/tests
await docker untimed
# frames in real time: nothing beside
check "integration" "$bin/pytest" -q -m "not long and not docker and not browser and not untimed" tests
if [ -n "${ARMSIGHT_CI:-}" ]; then
    check "install a browser" tools/install-apt-packages.sh tools/apt-packages-browser.txt
fi
if command -v chromium >/dev/null || [ -n "${ARMSIGHT_CI:-}" ]; then
    check "browser" "$bin/pytest" -q -m "browser and not long" tests
else
    echo "test: left out what needs Chromium (tests marked browser): tools/install-apt-packages.sh" \
        "tools/apt-packages-browser.txt installs it"
fi

if [ ${#failed[@]} -gt 0 ]; then
    printf 'failed: %s\n' "${failed[*]}" >&2
    exit 1
fi
echo "all tests passed"
