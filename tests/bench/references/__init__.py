"""Operations of the toolbox against independent references, one file a group.

A check is a generator: given the toolbox and the recorded data it yields `Finding`s. References are imported
inside of it, so that one that is not installed leaves out its checks only.
"""
