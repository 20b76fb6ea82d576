"""The cloud as oriented surfels: moments, planes, patches."""
