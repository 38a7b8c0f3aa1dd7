"""Logs come out of a real S3 server by the interface that stores use."""

from demoplan.pipeline.episodes.fetching import fetch_logs
from demoplan.store.opening import open_place


def test_logs_come_from_a_bucket_once(bucket_url, tmp_path):
    place = open_place(bucket_url)
    place.write("day/one.mcap", b"log" * 1000)
    (fetched,) = fetch_logs(place, tmp_path, quiet_s=0.0)
    assert (fetched.file, fetched.n_bytes, fetched.refusal) == ("day/one.mcap", 3000, "")
    assert (tmp_path / "day" / "one.mcap").read_bytes() == b"log" * 1000
    assert fetch_logs(place, tmp_path, quiet_s=0.0) == []
