#!/usr/bin/env bash
# Prints the path of the Python for tools/client/drive.py, in a virtual environment with its packages.
set -euo pipefail
cd "$(dirname "$0")/../.."
. tools/scripts/python_tools.sh
python_tools client_python.sh
echo "$PWD/$python"
