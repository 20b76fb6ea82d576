"""Hard cases: where a naive way fails, shown by running it beside the project's own."""
