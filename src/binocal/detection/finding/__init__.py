"""Where a board may be in an image: X-corners, lattices, spots and markers, to a pixel or so."""
