"""The studio: a page to set landmarks on two models, see their map and bake.

`state` and `landmarks` are frozen values with pure functions. `compute` runs in the process of a `worker`. `session`
holds the state that all pages show and their actions. `page` is the page with its messages and server.
"""
