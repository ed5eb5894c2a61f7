"""Linear structures by their matrices: read, reduced to a few coordinates, made into systems."""
