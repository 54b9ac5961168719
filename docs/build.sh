#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Makes the documentation of the interface with Doxygen: docs/build.sh [FOLDER], by default
# build/docs/html. A warning is an error. Then looks whether the links between the pages lead anywhere.
set -euo pipefail
cd "$(dirname "$0")/.."

out=${1:-build/docs}
python3 tests/checks/docs.py
if ! command -v doxygen >/dev/null; then
  echo "doxygen is not installed: documentation not made"
  exit 0
fi
mkdir -p "$out"
{
  cat docs/Doxyfile
  echo "OUTPUT_DIRECTORY = $out"
  echo "PROJECT_NUMBER = $(sed -n 's/^#define FT_VERSION_[A-Z]* \([0-9]*\)$/\1/p' include/ft/version.hpp | paste -sd.)"
} | doxygen -
echo "documentation: $out/html/index.html"
