"""Poles seen in images and in the cloud: bearing, distance, columns."""
