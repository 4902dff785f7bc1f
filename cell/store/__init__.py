"""What survives the process: files, framed streams, journals, run folders and the ledger.

Everything here blocks on the disk. On an event loop call it through ``asyncio.to_thread``; the one exception
is ``Journal.append`` without ``fsync``, a single short write into the page cache.
"""
