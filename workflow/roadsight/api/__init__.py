"""What a notebook needs: ``import roadsight``, and arrays, tables or paths in and out."""
