"""Road edges: splines, the overhead view, curbs beside a track."""
