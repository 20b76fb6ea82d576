"""The generated highway and its mobile scanner."""
