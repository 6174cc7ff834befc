"""The perception toolbox: calls and answers, one file a group."""
