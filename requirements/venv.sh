#!/bin/sh
# Make the environment of `make demo` and `make test`, from exact versions, or add to it what is missing.
#
#   requirements/venv.sh wheels DIRECTORY run [test] [docs]    ROS 2 from PyPI wheels
#   requirements/venv.sh sourced DIRECTORY run [test] [docs]   ROS 2 from the sourced, apt-installed Jazzy
#   requirements/venv.sh kilted DIRECTORY run [test] [docs]    ROS 2 Kilted from PyPI wheels
#
# PYTHON names the interpreter to use; by default the first that serves. An environment that is there is kept, unless it
# was moved or is for another ROS or another interpreter than PYTHON.
set -eu

mode=$1
venv=$2
shift 2
here=$(dirname "$0")

fail() {
    printf 'error: %s\n' "$1" >&2
    exit 1
}

# Which one it is, of those that serve: built for all of them are CPython's wheels, not those without its lock.
identity='import platform, sys, sysconfig
version = sys.version_info
serves = (3, 11) <= version < (3, 15) and version.releaselevel == "final" and sys.maxsize > 2**32
print(platform.python_version(), sys.base_prefix)
sys.exit(not (serves and sys.implementation.name == "cpython" and not sysconfig.get_config_var("Py_GIL_DISABLED")))'

find_python() {
    for candidate in ${PYTHON:-python3 python3.13 python3.12 python3.11 python3.14}; do
        if "$candidate" -c "$identity" >/dev/null 2>&1; then
            printf '%s\n' "$candidate"
            return
        fi
    done
    found=$("${PYTHON:-python3}" --version 2>&1) || found="not there"
    fail "impact_rig needs CPython 3.11 to 3.14, and ${PYTHON:-python3} is $found: make PYTHON=/path/to/python3.12 ..."
}

# settings of the user's pip that would install somewhere else
unset PIP_USER PIP_TARGET PIP_PREFIX PIP_REQUIRE_VIRTUALENV PIP_REQUIREMENT PIP_CONSTRAINT

[ "$mode" = sourced ] || [ "$(uname -sm)" = "Linux x86_64" ] ||
    fail "the ROS 2 wheels exist for Linux x86-64 only, this is $(uname -sm): install ROS 2 Jazzy and source its setup.bash"

mkdir -p "$(dirname "$venv")"
directory=$(cd "$(dirname "$venv")" && pwd)
kept=$("$venv/bin/python" -c "$identity" 2>/dev/null) || kept=
if [ -n "${PYTHON:-}" ]; then
    python=$(find_python)
    [ "$kept" = "$("$python" -c "$identity")" ] || kept=
fi
if [ -z "$kept" ] || [ ! -e "$venv/ready-$mode" ] || [ "$(cat "$venv/made-in")" != "$directory" ]; then
    python=$(find_python)
    [ "$mode" = sourced ] && site=--system-site-packages || site=
    # shellcheck disable=SC2086  # no option at all when empty
    "$python" -m venv --clear $site "$venv" ||
        fail "$python cannot make a virtual environment; on Debian and Ubuntu: sudo apt install python3-venv"
    printf '%s' "$directory" > "$venv/made-in"
    touch "$venv/ready-$mode"
fi
exec "$venv/bin/python" "$here/install.py" "$mode" "$@"
