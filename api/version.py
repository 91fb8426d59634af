"""The version of the package, which is also that of the HTTP interface. It is set in `pyproject.toml`."""

from importlib.metadata import PackageNotFoundError, version

UNINSTALLED = "0.0.0+uninstalled"


def installed_version(distribution: str = "dsl-assembly") -> str:
    """Return the version of an installed distribution, or `UNINSTALLED` in a checkout that was never installed."""
    try:
        return version(distribution)
    except PackageNotFoundError:
        return UNINSTALLED


VERSION = installed_version()
