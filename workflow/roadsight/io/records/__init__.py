"""Tables, arrays and JSON between the stages; checksums; atomic writes."""
