#!/usr/bin/env bash
# Builds these messages and installs them into the virtual environment $1, which has bindings/ros2/requirements.txt.
# Needs a C and a C++ compiler and the headers of Python. A ROS installation has vision_msgs already.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
venv=$(cd "$1" && pwd)
build=$here/../target/vision_msgs
rm -rf "$build"
# Code generators are found by these.
export PATH=$venv/bin:$PATH AMENT_PREFIX_PATH=$venv
cmake -S "$here" -B "$build" -G Ninja -Wno-dev --log-level=WARNING -DCMAKE_BUILD_TYPE=Release \
    -DCMAKE_PREFIX_PATH="$venv" -DCMAKE_INSTALL_PREFIX="$venv" -DPython3_EXECUTABLE="$venv/bin/python"
cmake --build "$build" -- --quiet
cmake --install "$build" >"$build/installed.txt"
