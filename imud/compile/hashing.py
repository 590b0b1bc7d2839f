"""Digests against accidents. Python's own BLAKE2: `hashlib` would also load OpenSSL, which costs 3.5 MB of memory."""

try:
    from _blake2 import blake2b
except ImportError:  # a Python whose hashes all come from OpenSSL
    from hashlib import blake2b


def digest_of(*parts: bytes | memoryview) -> str:
    """64 hexadecimal digits of the parts, one after the other.

    >>> digest_of(b"a", b"b") == digest_of(b"ab")
    True
    """
    digest = blake2b(digest_size=32)
    for part in parts:
        digest.update(part)
    return digest.hexdigest()
