"""The studio: two models side by side in the browser, landmarks by click, the map live, the bake at the end.

`state` and `landmarks` are pure values with pure transitions; `compute` computes, in a process of its own behind
`worker`; `session` holds the one state that all pages show; `page` is the page itself and what serves it.
"""
