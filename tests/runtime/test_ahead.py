"""Work of the host that a thread does ahead."""

import threading

import pytest

from warpqem.runtime.ahead import done_ahead


def test_result_of_work_done_ahead_is_there_as_often_as_it_is_asked_for():
    threads = []

    def work():
        threads.append(threading.get_ident())
        return 7

    result = done_ahead(work)
    assert (result(), result()) == (7, 7)
    assert len(threads) == 1
    assert threads[0] != threading.get_ident()


def test_an_error_of_work_done_ahead_comes_where_its_result_is_asked_for():
    result = done_ahead(lambda: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        result()
