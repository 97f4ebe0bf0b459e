"""From the files of `conf` and the command line to checked objects."""
