"""A campaign of attacks that anyone can run: files that bite, damaged folders, processes that die."""
