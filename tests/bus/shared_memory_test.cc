#include "bus/shared_memory.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/file.h>
#include <sys/wait.h>
#include <unistd.h>

#include <fstream>

namespace secondskin::bus {
namespace {

namespace fs = std::filesystem;

struct Folder {
  fs::path path = fs::temp_directory_path() / ("shm_test_" + std::to_string(::getpid()));
  Folder() { fs::create_directories(path); }
  ~Folder() { fs::remove_all(path); }
  void file(const std::string& name) const { std::ofstream(path / name) << "x"; }
};

TEST(SharedMemory, OfAKilledProcessIsRemovedAndOfALivingOneStays) {
  const Folder folder;
  for (const char* name :
       {"fastrtps_00000000000000aa", "fastrtps_00000000000000aa_el", "fastrtps_port9001",
        "fastrtps_port9001_el", "sem.fastrtps_port9001_mutex", "somebody_elses"}) {
    folder.file(name);
  }
  int ready[2];
  ASSERT_EQ(::pipe(ready), 0);
  const pid_t owner = ::fork();
  if (owner == 0) {  // holds the first lock, as a Fast DDS process does, until it is killed
    const int fd = ::open((folder.path / "fastrtps_00000000000000aa_el").c_str(), O_RDONLY);
    ::flock(fd, LOCK_EX);
    (void)!::write(ready[1], "r", 1);
    for (;;) ::pause();
  }
  char byte;
  ASSERT_EQ(::read(ready[0], &byte, 1), 1);

  auto cleaning = remove_stale_shared_memory(folder.path);
  EXPECT_EQ(cleaning.removed, 1u);
  EXPECT_EQ(cleaning.in_use, 1u);
  EXPECT_TRUE(fs::exists(folder.path / "fastrtps_00000000000000aa"));
  EXPECT_FALSE(fs::exists(folder.path / "fastrtps_port9001"));
  EXPECT_FALSE(fs::exists(folder.path / "sem.fastrtps_port9001_mutex"));

  ::kill(owner, SIGKILL);
  ::waitpid(owner, nullptr, 0);
  cleaning = remove_stale_shared_memory(folder.path);
  EXPECT_EQ(cleaning.removed, 1u);
  EXPECT_FALSE(fs::exists(folder.path / "fastrtps_00000000000000aa"));
  EXPECT_TRUE(fs::exists(folder.path / "somebody_elses"));
  ::close(ready[0]);
  ::close(ready[1]);
}

TEST(SharedMemory, AFolderThatIsNotThereIsNoError) {
  EXPECT_EQ(remove_stale_shared_memory("/nonexistent/shm").removed, 0u);
}

}  // namespace
}  // namespace secondskin::bus
