"""The package for interpreters outside of the environment that the wheel is installed in: only Panoscope, and nothing else that lies there."""

from pathlib import Path

_real = Path(__file__).resolve().parents[5]
__path__ = [str(_real)]
__file__ = str(_real / "__init__.py")
exec(compile(Path(__file__).read_text(), __file__, "exec"))
