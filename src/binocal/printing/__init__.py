"""Boards for the printer, the cutter and the screen, true to scale.

One drawing in millimetres (:mod:`~binocal.printing.drawing`), made of a board and of notes (:mod:`~binocal.printing.sheet`), is
written as PDF, SVG, DXF or PNG. What is printed on each kind of board is stated once, for the simulator too, in
:mod:`binocal.simulation.layout`: a new kind that is made of cells or discs there can be printed.
"""
