"""
The rights of roles in files, and maps as text.

::

    rights      the rights of roles, as files have them
    map_texts   a map as text: a file, or a Python class
"""
