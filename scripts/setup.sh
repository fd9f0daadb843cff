#!/usr/bin/env bash
# Make .venv in the repository and install flexapod into it. Sourced by the other scripts:
#   source scripts/setup.sh EXTRA        EXTRA may be ""; leaves $python set to the environment's interpreter
set -euo pipefail

repository=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
extra=${1:-}
environment=${FLEXAPOD_VENV:-$repository/.venv}

fail() {
    echo "flexapod: $*" >&2
    exit 1
}

if [ ! -x "$environment/bin/python" ]; then
    base=""
    for name in ${PYTHON:-python3 python3.14 python3.13 python3.12 python3.11}; do
        if command -v "$name" >/dev/null 2>&1 &&
            "$name" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            base=$name
            break
        fi
    done
    [ -n "$base" ] || fail "Python 3.11 or newer is needed and was not found; install it, or" \
        "name it: PYTHON=/path/to/python3.12 bash $0"
    echo "flexapod: making $environment with $("$base" --version)" >&2
    if ! "$base" -m venv "$environment" >&2; then
        rm -rf "$environment"
        fail "could not make a virtual environment; on Debian or Ubuntu: apt-get install python3-venv"
    fi
fi
python=$environment/bin/python

# The sources and the extra decide whether an installation is still the right one.
stamp=$environment/.flexapod-installed
wanted="$extra $(cd "$repository" && cat pyproject.toml README.md \
    $(find core materials geometry contact fem dynamics app cases -type f \
        ! -path '*__pycache__*' 2>/dev/null | LC_ALL=C sort) | cksum)"
if [ ! -f "$stamp" ] || [ "$(cat "$stamp")" != "$wanted" ]; then
    echo "flexapod: installing into $environment" >&2
    # A copy, not an editable installation: what is tested is what users get. The build
    # folder of an earlier installation would carry removed files into the new one.
    rm -rf "$repository/build"
    # Of the same version number, only an uninstalled package is replaced by newer sources.
    "$python" -m pip uninstall --quiet --yes flexapod >&2 2>/dev/null || true
    "$python" -m pip install --quiet --disable-pip-version-check \
        "$repository${extra:+[$extra]}" >&2
    rm -rf "$repository/build"
    echo "$wanted" >"$stamp"
fi

# The gmsh wheel needs a few system libraries that slim images leave out.
if ! (cd / && "$python" -c 'import gmsh') >/dev/null 2>&1; then
    libraries="libglu1-mesa libgl1 libxrender1 libxcursor1 libxft2 libxinerama1 libxfixes3 libgomp1"
    if command -v apt-get >/dev/null 2>&1 && [ "$(id -u)" -eq 0 ]; then
        echo "flexapod: installing system libraries for gmsh: $libraries" >&2
        apt-get update -qq >&2 || true
        # shellcheck disable=SC2086
        DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
            $libraries >&2 || true
    fi
    if ! (cd / && "$python" -c 'import gmsh') >&2; then
        fail "gmsh cannot be loaded; install its system libraries, on Debian or Ubuntu:" \
            "sudo apt-get install $libraries"
    fi
fi
