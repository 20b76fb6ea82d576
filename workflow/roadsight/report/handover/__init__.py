"""What GIS and CAD people and crews take along: layers, a project, KML, a drawing, a table."""
