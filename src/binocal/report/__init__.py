"""Results as figures and pages: draws, never computes. Matplotlib and Jinja are imported here alone.

:mod:`~binocal.report.page` makes the page of ``binocal report`` from :class:`~binocal.report.contents.ReportContents`. What is drawn
on Matplotlib's axes is one function each, for the page and for a notebook alike: :mod:`~binocal.report.corner_figures`,
:mod:`~binocal.report.sigma_figures`, :mod:`~binocal.report.rig_figures`.
"""
