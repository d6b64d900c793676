"""The studio: two models side by side in the browser, landmarks by click, the map live, the bake at the end.

`state` and `landmarks` are pure values with pure transitions; `bench` computes, in a process of its own behind
`worker`; `session` holds the one state that all pages share; `page` shows it through viser, behind one `door`.
"""
