import threading
import time

import pytest

from roadsight.stages.scene.rasterise_lidar import in_order


@pytest.mark.parametrize("threads", [1, 2, 3, 8])
@pytest.mark.parametrize("count", [0, 1, 2, 30])
def test_results_come_in_the_order_of_the_items(threads, count):
    def work(item):
        time.sleep((item * 7 % 3) / 1000)
        return -item

    assert list(in_order(work, range(count), threads)) == [-i for i in range(count)]


@pytest.mark.parametrize("threads", [1, 2, 4])
def test_few_items_are_taken_ahead_and_few_threads_work(threads):
    taken, running, most, lock = 0, 0, 0, threading.Lock()

    def items():
        nonlocal taken
        for item in range(40):
            taken += 1
            yield item

    def work(item):
        nonlocal running, most
        with lock:
            running += 1
            most = max(most, running)
        time.sleep(0.001)
        with lock:
            running -= 1
        return item

    for used, _ in enumerate(in_order(work, items(), threads), start=1):
        assert taken - used <= (threads if threads > 1 else 0)
    assert most <= max(threads - 1, 1)


@pytest.mark.parametrize("threads", [1, 3])
def test_an_error_comes_where_its_result_would(threads):
    results = in_order(lambda item: 1 // (3 - item), range(9), threads)
    assert [next(results) for _ in range(3)] == [0, 0, 1]
    with pytest.raises(ZeroDivisionError):
        next(results)
