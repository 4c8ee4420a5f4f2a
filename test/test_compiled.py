"""What was compiled from other sources is never loaded."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from pathlib import Path

from impact_rig.compiled import discard_stale

CALLEE = "from numba import njit\n@njit(cache=True)\ndef inner(x):\n    return x + {}\n"
CALLER = "from numba import njit\nfrom callee import inner\n@njit(cache=True)\ndef outer(x):\n    return inner(x)\n"


def outer(package: Path) -> int:
    script = textwrap.dedent(f"""
        import sys
        from pathlib import Path
        from impact_rig.compiled import discard_stale
        discard_stale(Path({str(package)!r}))
        sys.path.insert(0, {str(package)!r})
        from caller import outer
        print(outer(1))
    """)
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    done = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True, env=environment)
    return int(done.stdout)


def test_an_edit_of_a_callee_reaches_its_callers(tmp_path: Path) -> None:
    (tmp_path / "callee.py").write_text(CALLEE.format(1))
    (tmp_path / "caller.py").write_text(CALLER)
    assert outer(tmp_path) == 2
    (tmp_path / "callee.py").write_text(CALLEE.format(10))
    os.utime(tmp_path / "callee.py", ns=(1, 1))  # whatever the clock says
    assert outer(tmp_path) == 11


def test_unchanged_sources_keep_what_was_compiled(tmp_path: Path) -> None:
    (tmp_path / "module.py").write_text("")
    compiled = tmp_path / "__pycache__" / "module.f-1.py311.nbi"
    discard_stale(tmp_path)
    compiled.write_bytes(b"")
    assert not discard_stale(tmp_path)
    assert compiled.exists()
    (tmp_path / "module.py").write_text("1")
    assert discard_stale(tmp_path)
    assert not compiled.exists()


def test_a_package_that_cannot_be_written_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "module.py").write_text("")
    (tmp_path / "__pycache__").write_text("a file where the directory should be")
    assert not discard_stale(tmp_path)
