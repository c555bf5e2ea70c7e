"""One thread for small matrices: numpy and scipy are told so, and told back."""

from threadpoolctl import threadpool_info, threadpool_limits

from daest.numerics.threads import one_thread


def threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_numpy_and_scipy_work_in_one_thread_for_as_long_as_it_is_asked():
    @one_thread()
    def inside() -> set[int]:
        return threads()

    with threadpool_limits(2):
        assert inside() == {1}
        with one_thread():
            assert threads() == {1}
            assert inside() == {1}
            assert threads() == {1}
        assert threads() == {2}
