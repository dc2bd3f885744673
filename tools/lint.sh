#!/usr/bin/env bash
# Every formatter, linter and type checker; runs all of them and fails if any did.
set -uo pipefail
cd "$(dirname "$0")/.."
bin=$PWD/.venv/bin
bridge=services/vision_cpp/zenoh_bridge/Cargo.toml
mapfile -t cpp < <(git ls-files --cached --others --exclude-standard '*.cpp' '*.hpp')
mapfile -t cpp_sources < <(git ls-files --cached --others --exclude-standard 'services/vision_cpp/*.cpp' | grep -v /fuzz/)
failed=()

check() { # check NAME COMMAND...
    local name=$1
    shift
    echo "lint: $name"
    "$@" || failed+=("$name")
}

in_folder() { # in_folder FOLDER COMMAND...
    (cd "$1" && shift && "$@")
}

check "ruff format" "$bin/ruff" format --check --quiet proto services tests bench tools docs examples
check "ruff check" "$bin/ruff" check --quiet proto services tests bench tools docs examples
check "buf lint" in_folder proto "$bin/buf" lint
check "mypy proto" in_folder proto "$bin/mypy" armsight tools hatch_build.py tests
for service in sim control camera operator; do
    check "mypy $service" in_folder "services/$service" "$bin/mypy" "armsight_$service" tests
done
check "mypy tests" "$bin/mypy" tests bench tools docs/figures examples
# broken links fail, but with --quiet; the variable: see Makefile
check "docs" env NO_MKDOCS_2_WARNING=1 "$bin/mkdocs" build --strict
# DL3008: Debian's stable release fixes versions itself, and drops those that had holes
check "hadolint" "$bin/hadolint" --ignore DL3008 services/*/Dockerfile
check "clang-format" "$bin/clang-format" --dry-run --Werror "${cpp[@]}"
check "rustfmt" cargo fmt --check --manifest-path "$bridge"
check "clippy" cargo clippy --quiet --release --all-targets --manifest-path "$bridge" --target-dir build/vision/cargo -- -D warnings
check "clang-tidy" xargs -P "$(nproc)" -n 1 tools/tidy.sh < <(printf '%s\n' "${cpp_sources[@]}")

if [ ${#failed[@]} -gt 0 ]; then
    printf 'lint failed: %s\n' "${failed[*]}" >&2
    exit 1
fi
