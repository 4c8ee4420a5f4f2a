#!/bin/sh
# Build the library of compiled kernels where it is not there, or not of these sources: `requirements/kernels.sh VENV`.
#
# Running needs no compiler, building needs Numba: that of the environment, where the tests have brought it, else one that
# is fetched and removed again. Without a C compiler Numba is installed to stay, and compiles each kernel at its first call.
set -eu

python=$1/bin/python
here=$(dirname "$0")

"$python" -c 'import sys; from impact_rig.kernels.build import is_built; sys.exit(not is_built())' && exit
pip() { "$python" -W ignore -m pip install --quiet --no-compile --no-deps --no-input --disable-pip-version-check "$@"; }

if ! command -v "${CC:-cc}" >/dev/null; then
    echo 'no C compiler: Numba compiles the kernels at their first call, which takes a minute'
    exec "$python" "$here/install.py" wheels kernels
fi
if ! "$python" -c 'import numba' 2>/dev/null; then
    fetched=$(mktemp -d)
    trap 'rm -rf "$fetched"' EXIT
    echo 'building kernels: fetching what compiles them, 60 MB, removed afterwards'
    pip --target "$fetched" --requirement "$here/kernels.txt"
    export PYTHONPATH="$fetched"
fi
"$python" -m impact_rig.kernels.build --keep "$here/../build/kernels"
