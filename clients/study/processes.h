#pragma once

#include <cstddef>
#include <functional>
#include <vector>

namespace secondskin::study {

/// Runs task 0 to count - 1 in several processes, because the solver's MUMPS serves one thread in a
/// process. The tasks must not depend on one another; call it before any thread is started.
/// @param task      gives a task's result; runs in a child
/// @param finished  called here after each task, with how many are done
/// @throws std::runtime_error with a task's error, or when a child died
std::vector<std::vector<double>> in_processes(
    std::size_t count, unsigned processes,
    const std::function<std::vector<double>(std::size_t)>& task,
    const std::function<void(std::size_t)>& finished);

}  // namespace secondskin::study
