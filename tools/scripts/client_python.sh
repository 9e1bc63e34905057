#!/usr/bin/env bash
# Prints the Python that tools/client/drive.py runs with: a virtual environment with its packages.
set -euo pipefail
cd "$(dirname "$0")/../.."
. tools/scripts/python_tools.sh
python_tools client_python.sh
echo "$PWD/$python"
