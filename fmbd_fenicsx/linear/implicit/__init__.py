"""What the points of implicit steps solve: their pencils of matrices."""
