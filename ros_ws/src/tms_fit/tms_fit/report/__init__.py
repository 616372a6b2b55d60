"""The report of a recording: one HTML file to look at, to print and to hand on, and its figures for papers.

`document.report_html` makes the file: `strike_section` and `overview` say in words and tables what was found,
`charts` hold what is drawn (Vega-Lite specifications, one noun per file), `datasets` the numbers behind them.
Text comes from bags that nobody vouches for, so that it enters the page through `element` only, which escapes
it, and numbers through `page`.
"""
