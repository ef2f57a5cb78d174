#include "clients/study/processes.h"

#include <poll.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <system_error>

namespace secondskin::study {
namespace {

bool write_all(int fd, const void* data, std::size_t size) noexcept {
  const char* from = static_cast<const char*>(data);
  while (size > 0) {
    const ssize_t n = ::write(fd, from, size);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return false;
    from += n;
    size -= static_cast<std::size_t>(n);
  }
  return true;
}

bool read_all(int fd, void* data, std::size_t size) noexcept {
  char* to = static_cast<char*>(data);
  while (size > 0) {
    const ssize_t n = ::read(fd, to, size);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return false;
    to += n;
    size -= static_cast<std::size_t>(n);
  }
  return true;
}

// What precedes a result, or the text of an error.
struct Head {
  std::uint64_t task = 0;
  std::uint64_t size = 0;  // of the doubles, or of the text
  bool error = false;
};

[[noreturn]] void work(int out, std::size_t first, std::size_t step, std::size_t count,
                       const std::function<std::vector<double>(std::size_t)>& task) {
  for (std::size_t i = first; i < count; i += step) {
    try {
      const auto result = task(i);
      const Head head{i, result.size(), false};
      if (!write_all(out, &head, sizeof head) ||
          !write_all(out, result.data(), result.size() * sizeof(double))) {
        ::_exit(1);  // nobody waits for it any more
      }
    } catch (const std::exception& error) {
      const std::string words = error.what();
      const Head head{i, words.size(), true};
      (void)(write_all(out, &head, sizeof head) && write_all(out, words.data(), words.size()));
      ::_exit(1);
    }
  }
  ::_exit(0);
}

struct Child {
  pid_t pid = -1;
  int fd = -1;
};

// Ends what still runs, whatever made us leave.
struct Children {
  std::vector<Child> list;
  ~Children() {
    for (Child& child : list) {
      if (child.fd >= 0) ::close(child.fd);
      ::kill(child.pid, SIGTERM);
      ::waitpid(child.pid, nullptr, 0);
    }
  }
};

}  // namespace

std::vector<std::vector<double>> in_processes(
    std::size_t count, unsigned processes,
    const std::function<std::vector<double>(std::size_t)>& task,
    const std::function<void(std::size_t)>& finished) {
  std::vector<std::vector<double>> results(count);
  Children children;
  const std::size_t step = std::clamp<std::size_t>(processes, 1, std::max<std::size_t>(1, count));
  for (std::size_t c = 0; c < step; ++c) {
    int ends[2];
    if (::pipe(ends) != 0) {
      throw std::system_error(errno, std::generic_category(), "no pipe to a process");
    }
    const pid_t pid = ::fork();
    if (pid < 0) throw std::system_error(errno, std::generic_category(), "no more processes");
    if (pid == 0) {
      ::close(ends[0]);
      work(ends[1], c, step, count, task);
    }
    ::close(ends[1]);
    children.list.push_back({pid, ends[0]});
  }
  for (std::size_t done = 0; done < count;) {
    std::vector<pollfd> watched;
    for (const Child& child : children.list) watched.push_back({child.fd, POLLIN, 0});
    if (::poll(watched.data(), watched.size(), -1) < 0 && errno != EINTR) {
      throw std::system_error(errno, std::generic_category(), "the processes cannot be watched");
    }
    for (std::size_t c = 0; c < watched.size(); ++c) {
      if ((watched[c].revents & (POLLIN | POLLHUP)) == 0) continue;
      Child& child = children.list[c];
      Head head;
      if (!read_all(child.fd, &head, sizeof head)) {
        // Its share is done, or it died.
        const bool complete = [&] {
          for (std::size_t i = c; i < count; i += step) {
            if (results[i].empty()) return false;
          }
          return true;
        }();
        if (!complete) throw std::runtime_error("a process of the study died");
        ::close(child.fd);
        child.fd = -1;  // poll leaves it out
        continue;
      }
      if (head.error) {
        std::string words(head.size, ' ');
        (void)read_all(child.fd, words.data(), words.size());
        throw std::runtime_error(words);
      }
      results.at(head.task).resize(head.size);
      if (!read_all(child.fd, results[head.task].data(), head.size * sizeof(double))) {
        throw std::runtime_error("a process of the study died");
      }
      finished(++done);
    }
  }
  return results;
}

}  // namespace secondskin::study
