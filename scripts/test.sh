#!/usr/bin/env bash
# Set everything up and run the tests. Arguments are passed on to pytest.
set -euo pipefail
arguments=("$@")
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh" test
cd "$repository"
# PYTHONSAFEPATH keeps the repository's own folders from shadowing the installed package.
export PYTHONSAFEPATH=1
exec "$python" -m pytest "${arguments[@]+"${arguments[@]}"}"
