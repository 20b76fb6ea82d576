"""One module per rule: read, call, write.

Libraries bring some hundred thousand objects that live to the end. Garbage is looked for less often
while they load, and not among all of them once more when the process ends: that takes as long as
loading the largest of them.
"""

import atexit
import gc

_NEW_OBJECTS = 10_000
"""New objects after which garbage is looked for, many times what Python does by itself."""

gc.set_threshold(_NEW_OBJECTS)
atexit.register(gc.freeze)
