#!/usr/bin/env bash
# Set everything up and run the curling part: results in results/curl. Arguments are passed on,
# for example: bash scripts/curl.sh --set mesh.size=coarse
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh" ""
cd "$repository"
exec "$environment/bin/flexapod" run cases/curl.toml "$@"
