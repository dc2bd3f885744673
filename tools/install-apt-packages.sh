#!/usr/bin/env bash
# Installs the Debian packages of a list (tools/apt-packages.txt) that are missing, or says which they are.
set -euo pipefail
list=${1:-$(dirname "$0")/apt-packages.txt}

missing=()
while read -r package; do
    case "$package" in '' | '#'*) continue ;; esac
    state=$(dpkg-query --show --showformat='${db:Status-Status}' "$package" 2>/dev/null || true)
    [ "$state" = installed ] || missing+=("$package")
done <"$list"
[ ${#missing[@]} -gt 0 ] || exit 0

if [ "$(id -u)" = 0 ]; then
    as_root=()
elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then
    as_root=(sudo)
else
    echo "These Debian packages are missing, and this user may not install them:" >&2
    echo "    apt-get install ${missing[*]}" >&2
    exit 1
fi
echo "installing ${missing[*]}"
"${as_root[@]}" apt-get update -qq
"${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
