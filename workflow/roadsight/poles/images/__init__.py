"""What images show: classes, lane markings, borders, poles in masks, lens."""
