#!/bin/sh
# Makes the virtual environment that the Makefile runs everything in.
#   install.sh PYTHON VENV sourced|wheels [CONSTRAINTS]   what the package and its tests need
#   install.sh --lint VENV                                what `make lint` needs, on top
#   install.sh --docs VENV                                what `make docs` needs, on top
#   install.sh --benchmark VENV                           what `make benchmark` needs, on top
set -eu
cd "$(dirname "$0")/.."

fail() {
    echo "error: $1" >&2
    exit 1
}

install() {
    what=$1
    shift
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check "$@" || fail \
        "could not install $what (see above). It comes from the Python package index: check the network, or pip's index settings"
}

if [ "$1" = --lint ]; then
    venv=$2
    install "ruff and mypy" --require-hashes -r requirements/lint.txt
    exit 0
fi

if [ "$1" = --docs ]; then
    venv=$2
    install "sphinx, myst-parser and furo" --require-hashes -r requirements/docs.txt
    exit 0
fi

if [ "$1" = --benchmark ]; then
    venv=$2
    echo "Installing the star identifiers to compare with (pinned by hash; 100 MB) ..."
    # Without dependencies: one peer asks for an older numpy than it needs, see benchmark.in.
    install "tetra3rs and ruststartracker" \
        --no-deps --require-hashes -r requirements/benchmark.txt
    exit 0
fi

python=$1 venv=$2 ros=$3 constraints=${4:-}

"$python" -c 'import sys; sys.exit(sys.version_info < (3, 10))' ||
    fail "$python is older than Python 3.10: choose another with PYTHON=python3.12"

# A sourced ROS 2 stays visible inside of the environment; only what it lacks is installed.
if [ "$ros" = sourced ]; then site=--system-site-packages; else site=; fi
"$python" -m venv --clear $site "$venv" ||
    fail "$python cannot make a virtual environment: apt install python3-venv"

if [ "$ros" = sourced ] || [ -n "$constraints" ]; then
    echo "Installing numpy, scipy, numba, matplotlib and pytest ..."
    install "the Python libraries" ${constraints:+-c "$constraints"} \
        numpy scipy numba rich matplotlib joblib jinja2 PyYAML distributed pyerfa rosbags \
        "pytest<9" pytest-xdist coverage playwright hypothesis xlrd "setuptools>=70.1,<80" wheel
else
    echo "Installing numpy, scipy, numba, matplotlib and pytest (pinned by hash) ..."
    install "the Python libraries" --require-hashes -r requirements/python.txt
fi
if [ "$ros" = wheels ]; then
    echo "Installing ROS 2 Jazzy's rclpy and common_interfaces (pinned by hash) ..."
    install "rclpy and common_interfaces" \
        --no-deps --no-build-isolation --require-hashes -r requirements/ros.txt
fi
install "star_tracker itself" --no-deps --no-index --no-build-isolation --use-pep517 --editable .
