#!/bin/sh
# Build the library of compiled kernels where it is not there, or not of these sources: `requirements/kernels.sh VENV`.
#
# Running needs no compiler, building needs Numba: that of the environment, where the tests have brought it, else one that
# is fetched and removed again. Where IMPACT_RIG_KERNELS=jit, Numba is installed to stay, and compiles at each first call.
set -eu

python=$1/bin/python
here=$(dirname "$0")

case ${IMPACT_RIG_KERNELS:-} in
jit) exec "$python" "$here/install.py" wheels kernels ;;
plain) exit ;;
esac
unset IMPACT_RIG_KERNELS
"$python" -c 'import sys; from impact_rig.kernels.build import is_built; sys.exit(not is_built())' && exit
pip() { "$python" -W ignore -m pip install --quiet --no-compile --no-deps --no-input --disable-pip-version-check "$@"; }

compiler=${CC:-cc}
if ! command -v "${compiler%% *}" >/dev/null; then
    echo "error: no C compiler $compiler: install gcc (sudo apt install gcc libc6-dev), or set IMPACT_RIG_KERNELS=jit:" \
        'Numba then compiles the kernels at their first call, which takes a minute' >&2
    exit 1
fi
if ! "$python" -c 'import numba' 2>/dev/null; then
    fetched=$(mktemp -d)
    trap 'rm -rf "$fetched"' EXIT
    echo 'building kernels: fetching Numba, which translates them for the C compiler: 60 MB, removed afterwards'
    pip --target "$fetched" --requirement "$here/kernels.txt"
    export PYTHONPATH="$fetched"
fi
"$python" -m impact_rig.kernels.build --keep "$here/../build/kernels"
