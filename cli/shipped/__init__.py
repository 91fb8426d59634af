"""The policies and example configurations that come with the command.

`models` and `config` are links to the repository's folders of these names; a wheel holds the files themselves.
"""

from pathlib import Path

MODELS = Path(__file__).parent / "models"
EXAMPLES = Path(__file__).parent / "config"
