"""Many assets: jobs, the processes that do them, and what is known of those that are done.

An engine runs jobs somewhere and gives back one result for each, whatever happens to the process that had it. Nothing
here knows the command line.
"""
