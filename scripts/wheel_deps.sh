#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Installs what the wheel needs in the images of manylinux_2_28 (AlmaLinux 8, as root). pyproject.toml names it for cibuildwheel.
set -euo pipefail

dnf -y -q install epel-release dnf-plugins-core
dnf config-manager --set-enabled powertools
dnf -y -q install eigen3-devel libpng-devel libjpeg-turbo-devel yaml-cpp-devel json-devel

# The distribution's oneTBB is older than 2021.
version=2021.13.0
sum=3ad5dd08954b39d113dc5b3f8a8dc6dc1fd5250032b7c491eb07aed5c94133e1
folder=$(mktemp -d)
curl -fsSL -o "$folder/tbb.tar.gz" "https://github.com/uxlfoundation/oneTBB/archive/refs/tags/v$version.tar.gz"
echo "$sum  $folder/tbb.tar.gz" | sha256sum --check --quiet
tar -xf "$folder/tbb.tar.gz" -C "$folder"
cmake -S "$folder/oneTBB-$version" -B "$folder/build" -DCMAKE_BUILD_TYPE=Release -DTBB_TEST=OFF -DTBBMALLOC_BUILD=OFF
cmake --build "$folder/build" --parallel
cmake --install "$folder/build"
rm -rf "$folder"
