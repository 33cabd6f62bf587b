"""However messages are spread over chunks and files, the same records come back."""

from __future__ import annotations

import tempfile
from itertools import pairwise
from pathlib import Path

import mcapfiles as files
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType
from mcapfiles import SECOND, T0

from roclog.recording.reader import open_recording

_seq = st.integers(1, 2**32 - 1)
_items = st.lists(
    st.one_of(
        st.builds(files.sample, _seq, at=st.integers(T0, T0 + 100 * SECOND)),
        st.builds(lambda at: files.gap(at, at - 5, at), st.integers(T0, T0 + 100 * SECOND)),
        st.builds(
            lambda at, text: files.event(at, message=text),
            st.integers(T0, T0 + 100 * SECOND),
            st.text(st.characters(codec="utf-8"), max_size=20),
        ),
    ),
    unique_by=lambda item: (item.topic, item.data),
    max_size=30,
)


@settings(max_examples=60, deadline=None)
@given(
    _items, st.lists(st.integers(1, 30), max_size=30), st.sampled_from(CompressionType), st.data()
)
def test_any_split_reads_the_same(
    items: list[files.Item], cuts: list[int], compression: CompressionType, data: st.DataObject
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        reference = files.write_sealed(root / "reference.mcap", items)
        expected = list(open_recording(reference).records())
        edges = sorted({0, len(items), *(cut for cut in cuts if cut < len(items))})
        parts = [items[a:b] for a, b in pairwise(edges)]
        hot = files.write_hot(root / "hot" / "1.mcap", parts)
        assert list(open_recording(hot).records()) == expected
        for number, part in enumerate(parts, start=1):
            size = data.draw(st.integers(1, 2000))
            files.write_sealed(
                root / "parts" / f"{number}.mcap",
                part,
                metadata=files.facts(number),
                chunk_size=size,
                compression=compression,
            )
        if parts:
            assert list(open_recording(root / "parts").records()) == expected
