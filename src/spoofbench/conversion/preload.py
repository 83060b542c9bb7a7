"""What a process that converts needs, imported once for all of them."""

from contextlib import suppress

import spoofbench.codec
import spoofbench.conversion.batch  # noqa: F401
from spoofbench import plugins
from spoofbench.errors import PluginError

with suppress(PluginError):  # to be told when it is asked for
    for _plugin in plugins.found(plugins.CONVERTERS).values():
        with suppress(PluginError):
            _plugin.load()
