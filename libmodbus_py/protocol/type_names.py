"""
The names of types and orders, as `values` explains them; type checkers find wrong names.
"""

from __future__ import annotations

from typing import Literal, TypedDict

__all__ = [
    "BitsType",
    "FloatType",
    "IntegerType",
    "Layout",
    "NumberType",
    "Order",
    "TextOptions",
    "TextType",
    "TimeType",
    "TypeName",
]

Order = Literal["ABCD", "CDAB", "BADC", "DCBA"]
"""The orders of bytes, by the names that hold for every width."""
# fmt: off
IntegerType = Literal[
    "int16", "int32", "int64", "uint16", "uint32", "uint64", "bcd16", "bcd32", "bcd64",
]
"""Types whose values are whole numbers."""
FloatType = Literal["float16", "float32", "float64"]
"""Types whose values are floats."""
NumberType = Literal[
    "int16", "int32", "int64", "uint16", "uint32", "uint64",
    "float16", "float32", "float64", "bcd16", "bcd32", "bcd64",
]
"""Types whose values are numbers."""
BitsType = Literal["bits16", "bits32", "bits64"]
"""Types whose values are lists of True and False."""
TimeType = Literal["unix32", "unix64", "ms64", "iec870", "date48", "bcddate48", "date96"]
"""Types whose values are datetimes."""
TextType = Literal[
    "string:1", "string:2", "string:3", "string:4", "string:5", "string:6", "string:7", "string:8",
    "string:9", "string:10", "string:11", "string:12", "string:13", "string:14", "string:15",
    "string:16", "string:17", "string:18", "string:19", "string:20", "string:21", "string:22",
    "string:23", "string:24", "string:25", "string:26", "string:27", "string:28", "string:29",
    "string:30", "string:31", "string:32", "string:33", "string:34", "string:35", "string:36",
    "string:37", "string:38", "string:39", "string:40", "string:41", "string:42", "string:43",
    "string:44", "string:45", "string:46", "string:47", "string:48", "string:49", "string:50",
    "string:51", "string:52", "string:53", "string:54", "string:55", "string:56", "string:57",
    "string:58", "string:59", "string:60", "string:61", "string:62", "string:63", "string:64",
    "string:65", "string:66", "string:67", "string:68", "string:69", "string:70", "string:71",
    "string:72", "string:73", "string:74", "string:75", "string:76", "string:77", "string:78",
    "string:79", "string:80", "string:81", "string:82", "string:83", "string:84", "string:85",
    "string:86", "string:87", "string:88", "string:89", "string:90", "string:91", "string:92",
    "string:93", "string:94", "string:95", "string:96", "string:97", "string:98", "string:99",
    "string:100", "string:101", "string:102", "string:103", "string:104", "string:105",
    "string:106", "string:107", "string:108", "string:109", "string:110", "string:111",
    "string:112", "string:113", "string:114", "string:115", "string:116", "string:117",
    "string:118", "string:119", "string:120", "string:121", "string:122", "string:123",
    "string:124", "string:125", "string:126", "string:127", "string:128", "string:129",
    "string:130", "string:131", "string:132", "string:133", "string:134", "string:135",
    "string:136", "string:137", "string:138", "string:139", "string:140", "string:141",
    "string:142", "string:143", "string:144", "string:145", "string:146", "string:147",
    "string:148", "string:149", "string:150", "string:151", "string:152", "string:153",
    "string:154", "string:155", "string:156", "string:157", "string:158", "string:159",
    "string:160", "string:161", "string:162", "string:163", "string:164", "string:165",
    "string:166", "string:167", "string:168", "string:169", "string:170", "string:171",
    "string:172", "string:173", "string:174", "string:175", "string:176", "string:177",
    "string:178", "string:179", "string:180", "string:181", "string:182", "string:183",
    "string:184", "string:185", "string:186", "string:187", "string:188", "string:189",
    "string:190", "string:191", "string:192", "string:193", "string:194", "string:195",
    "string:196", "string:197", "string:198", "string:199", "string:200", "string:201",
    "string:202", "string:203", "string:204", "string:205", "string:206", "string:207",
    "string:208", "string:209", "string:210", "string:211", "string:212", "string:213",
    "string:214", "string:215", "string:216", "string:217", "string:218", "string:219",
    "string:220", "string:221", "string:222", "string:223", "string:224", "string:225",
    "string:226", "string:227", "string:228", "string:229", "string:230", "string:231",
    "string:232", "string:233", "string:234", "string:235", "string:236", "string:237",
    "string:238", "string:239", "string:240", "string:241", "string:242", "string:243",
    "string:244", "string:245", "string:246", "string:247", "string:248", "string:249",
    "string:250",
]
"""Types whose values are text, of 1 to 250 bytes."""
# fmt: on
TypeName = Literal[NumberType, BitsType, TimeType, TextType]
"""All of them."""


class TextOptions(TypedDict, total=False):
    """The layout of strings in registers, as for `value_type`."""

    encoding: str
    padding: str


class Layout(TextOptions, total=False):
    """The layout of any value in registers."""

    order: Order
