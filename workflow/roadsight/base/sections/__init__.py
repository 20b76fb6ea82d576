"""Each setting once: type, default, range, unit and meaning, by the chapter it belongs to."""
