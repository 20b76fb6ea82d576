"""One module per part of the interface: ``create(project)`` gives its routes."""
