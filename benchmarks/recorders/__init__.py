"""The same recording made by each tool, each in a process of its own.

The scripts of the peers import nothing of pamrig, so that they run in any Python that has the
peer. Each reads jobs as JSON, one a line, from standard input and answers each with one line.
"""
