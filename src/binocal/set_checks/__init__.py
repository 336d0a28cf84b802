"""What is wrong with a whole set of views, though every view is sound: numbers of one solve, findings of many.

:mod:`~binocal.set_checks.pair_motion` compares what each camera leaves alone with what the pair leaves, and looks for a step, a drift
or two states of the rig in the order of the views; :mod:`~binocal.set_checks.copies` finds views that are one image.
"""
