"""Motions of many tasks, optimised beforehand, stored, and looked up while a crane works.

`specification` says which motions there are, `keys` by what each is known, `warm_starts` plans neighbours, `engine`
runs a build, `store` keeps what it finds, `lookup` answers queries, `carrying` leads stored motions to other paths.
"""
