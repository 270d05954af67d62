"""Jobs over this machine's cores: how far they are said to be."""

from musebot.protocols.simulation import pool


class Bar:
    """Keeps what a progress bar is told."""

    def __init__(self):
        self.told = []

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        pass

    def add_task(self, what, **numbers):
        self.told.append((what, numbers))

    def update(self, task, **numbers):
        self.told.append(numbers)


def test_what_was_done_before_is_no_speed_of_now(monkeypatch):
    def results(work, jobs, processes, show):
        show(0)
        show(3)
        yield from (work(*job) for job in jobs)

    bar, worked = Bar(), []
    monkeypatch.setattr(pool, "bar", lambda: bar)
    monkeypatch.setattr(pool, "results", results)
    pool.work_off("tests", worked.append, [(1,), (2,)], 2, 20, 5)
    assert bar.told == [
        ("2 tests", {"total": 20, "completed": 5}),
        {"completed": 5},
        {"completed": 8},
    ]
    assert worked == [1, 2]


def test_without_jobs_nothing_is_begun(monkeypatch):
    monkeypatch.setattr(pool, "bar", None)
    pool.work_off("tests", lambda: None, [], 1, 0)
