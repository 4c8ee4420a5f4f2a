#!/bin/sh
# Make the environment of `make demo` and `make test`, from exact versions.
#
#   requirements/venv.sh wheels DIRECTORY     ROS 2 from PyPI wheels
#   requirements/venv.sh sourced DIRECTORY    ROS 2 from the sourced, apt-installed Jazzy
#
# PYTHON names the interpreter to use; by default the first supported one of python3, python3.12, python3.11.
set -eu

mode=$1
venv=$2
here=$(dirname "$0")

fail() {
    printf 'error: %s\n' "$@" >&2
    exit 1
}

supported() {
    "$1" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 13))' 2>/dev/null
}

find_python() {
    for candidate in ${PYTHON:-python3 python3.12 python3.11}; do
        if supported "$candidate"; then
            printf '%s\n' "$candidate"
            return
        fi
    done
    found=$("${PYTHON:-python3}" --version 2>&1) || found="no ${PYTHON:-python3}"
    fail "impact_rig needs Python 3.11 or 3.12, found: $found" \
        "install one of them and call: make PYTHON=/path/to/python3.12 ..."
}

python=$(find_python)
if [ "$mode" = wheels ]; then
    [ "$(uname -sm)" = "Linux x86_64" ] || fail "the ROS 2 wheels exist for Linux x86-64 only, this is $(uname -sm)" \
        "install ROS 2 Jazzy, source its setup.bash and call make again"
    site=
    versions=wheels.txt
    ros="ROS 2 from PyPI wheels"
else
    site=--system-site-packages
    versions=sourced.txt
    ros="the sourced ROS 2 ${ROS_DISTRO:-}"
fi

# settings of the user's pip that would install somewhere else
unset PIP_USER PIP_TARGET PIP_PREFIX PIP_REQUIRE_VIRTUALENV PIP_REQUIREMENT PIP_CONSTRAINT

echo "Setting up $venv with $("$python" --version) and $ros, once: 900 MB, one minute to seven, by network and machine"
# shellcheck disable=SC2086  # no option at all when empty
"$python" -m venv --clear $site "$venv" ||
    fail "$python cannot make a virtual environment; on Debian and Ubuntu: sudo apt install python3-venv"
# Python compiles what it imports: compiling all of it here would take half a minute
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-input --no-compile \
    --requirement "$here/common.txt" --requirement "$here/$versions"
