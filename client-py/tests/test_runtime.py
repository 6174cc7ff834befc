"""What stands between the one source and asyncio."""

import asyncio

import pytest

from percept._async import _runtime as runtime


@pytest.mark.parametrize("ticks", range(8))
def test_a_cancellation_that_comes_with_the_word_is_not_forgotten(ticks):
    """asyncio.wait_for of Python 3.11 does: a stream whose task was cancelled went on."""

    async def scenario():
        changed = runtime.Changed()

        async def work():
            async with changed:
                await changed.wait(3600)
            await asyncio.sleep(3600)

        task = asyncio.create_task(work())
        await asyncio.sleep(0.01)
        async with changed:
            changed.notify_all()
        for _ in range(ticks):
            await asyncio.sleep(0)
        task.cancel()
        done, _ = await asyncio.wait([task], timeout=5)
        assert done
        assert task.cancelled()
        # It gave the lock back.
        async with changed:
            pass

    asyncio.run(scenario())


def test_word_comes_or_does_not_come_in_time():
    async def scenario():
        changed = runtime.Changed()
        async with changed:
            assert not await changed.wait(0.01)

        async def tell():
            async with changed:
                changed.notify_all()

        async with changed:
            telling = asyncio.create_task(tell())
            assert await changed.wait(5)
        await telling
        signal = runtime.Signal()
        assert not await signal.wait(0.01)
        signal.set()
        assert await signal.wait(5)

    asyncio.run(scenario())
