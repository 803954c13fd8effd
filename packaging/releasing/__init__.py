"""The steps of packaging/release, a file each."""
