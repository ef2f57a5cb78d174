#include "wire/serial_port.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <termios.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "wire/pseudo_terminal.h"

namespace secondskin::wire {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class SerialPortTest : public ::testing::Test {
 protected:
  SerialPortTest() {
    std::string pattern = (fs::temp_directory_path() / "secondskin-wire-XXXXXX").string();
    folder_ = ::mkdtemp(pattern.data());
  }
  ~SerialPortTest() override { fs::remove_all(folder_); }
  std::string in_folder(const char* name) const { return (folder_ / name).string(); }

  fs::path folder_;
};

std::vector<std::uint8_t> read_all(ByteLink& link) {
  std::vector<std::uint8_t> bytes;
  std::array<std::uint8_t, 256> buffer;
  while (const std::size_t count = link.read_some(buffer)) {
    bytes.insert(bytes.end(), buffer.begin(), buffer.begin() + static_cast<long>(count));
  }
  return bytes;
}

TEST_F(SerialPortTest, CarriesEveryByteValueUnchangedBothWays) {
  PseudoTerminal board;
  SerialPort port(board.slave_path());
  ASSERT_TRUE(port.poll(0.0)) << port.last_error();
  EXPECT_EQ(port.openings(), 1U);
  EXPECT_EQ(port.last_error(), "");
  std::vector<std::uint8_t> every;
  for (int byte = 0; byte < 256; ++byte) every.push_back(static_cast<std::uint8_t>(byte));
  ASSERT_EQ(port.write_some(every), every.size());
  EXPECT_EQ(read_all(board), every);
  ASSERT_EQ(board.write_some(every), every.size());
  EXPECT_EQ(read_all(port), every);
  EXPECT_TRUE(port.poll(1.0));
  EXPECT_EQ(port.openings(), 1U);
}

TEST_F(SerialPortTest, SetsThePortRawWithEightBitsAndItsSpeed) {
  PseudoTerminal board;
  SerialPort port(board.slave_path(), 9'600);
  ASSERT_TRUE(port.poll(0.0)) << port.last_error();
  termios settings{};
  ASSERT_EQ(::tcgetattr(port.fd(), &settings), 0);
  EXPECT_EQ(::cfgetospeed(&settings), speed_t{B9600});
  EXPECT_EQ(settings.c_lflag & (ICANON | ECHO | ISIG), 0U);
  EXPECT_EQ(settings.c_oflag & OPOST, 0U);
  EXPECT_EQ(settings.c_iflag & (IXON | ICRNL), 0U);
  EXPECT_DOUBLE_EQ(port.byte_rate(), 960.0);
  EXPECT_NE(::fcntl(port.fd(), F_GETFD) & FD_CLOEXEC, 0);
}

TEST_F(SerialPortTest, NeverWaitsOnAFullPort) {
  PseudoTerminal board;
  SerialPort port(board.slave_path());
  ASSERT_TRUE(port.poll(0.0));
  const std::vector<std::uint8_t> block(4096, 0);
  std::size_t total = 0;
  while (const std::size_t count = port.write_some(block)) {
    total += count;
    ASSERT_LT(total, 100'000'000U);
  }
  EXPECT_GT(total, 0U);
  EXPECT_TRUE(port.connected());  // full is not lost
  std::array<std::uint8_t, 16> none;
  EXPECT_EQ(port.read_some(none), 0U);
  EXPECT_TRUE(port.connected());
}

TEST_F(SerialPortTest, NoticesAPortThatVanishesAndOpensItWhenItReturns) {
  const std::string name = in_folder("board");
  std::optional<PseudoTerminal> board(name);
  SerialPort port(name);
  ASSERT_TRUE(port.poll(0.0)) << port.last_error();

  board.reset();
  EXPECT_FALSE(port.poll(0.3));
  EXPECT_FALSE(port.connected());
  EXPECT_EQ(port.fd(), -1);
  EXPECT_THAT(port.last_error(), HasSubstr(name));
  const std::array<std::uint8_t, 2> pair{1, 0};
  EXPECT_EQ(port.write_some(pair), 0U);

  board.emplace(name);
  EXPECT_FALSE(port.poll(0.3 + SerialPort::kRetryInterval / 2));  // not yet: tried at 0.3
  EXPECT_TRUE(port.poll(0.3 + SerialPort::kRetryInterval)) << port.last_error();
  EXPECT_EQ(port.openings(), 2U);
  EXPECT_EQ(port.last_error(), "");
  ASSERT_EQ(port.write_some(pair), 2U);
  EXPECT_EQ(read_all(*board), (std::vector<std::uint8_t>{1, 0}));
}

TEST_F(SerialPortTest, NoticesALostPortWhenWritingOrReadingToo) {
  for (const bool by_writing : {true, false}) {
    std::optional<PseudoTerminal> board(std::in_place);
    SerialPort port(board->slave_path());
    ASSERT_TRUE(port.poll(0.0));
    board.reset();
    std::array<std::uint8_t, 2> pair{1, 0};
    EXPECT_EQ(by_writing ? port.write_some(pair) : port.read_some(pair), 0U);
    EXPECT_FALSE(port.connected());
    EXPECT_THAT(port.last_error(), HasSubstr("disappeared"));
  }
}

TEST_F(SerialPortTest, SaysWhatToDoAboutAMissingPort) {
  SerialPort port(in_folder("nothing"));
  EXPECT_FALSE(port.poll(0.0));
  EXPECT_THAT(port.last_error(), HasSubstr(in_folder("nothing")));
  EXPECT_THAT(port.last_error(), HasSubstr("plug in"));
}

TEST_F(SerialPortTest, RefusesAFileThatIsNoPort) {
  std::ofstream(in_folder("file")) << "text";
  SerialPort port(in_folder("file"));
  EXPECT_FALSE(port.poll(0.0));
  EXPECT_THAT(port.last_error(), HasSubstr("no serial port"));
}

TEST_F(SerialPortTest, NamesTheGroupToJoinWhenItMayNotOpenThePort) {
  if (::geteuid() == 0) GTEST_SKIP() << "root may open everything";
  std::ofstream(in_folder("file")) << "text";
  ::chmod(in_folder("file").c_str(), 0);
  SerialPort port(in_folder("file"));
  EXPECT_FALSE(port.poll(0.0));
  EXPECT_THAT(port.last_error(), HasSubstr("dialout"));
}

TEST_F(SerialPortTest, RefusesAnEmptyPathAndOddSpeedsAtTheStart) {
  EXPECT_THROW(SerialPort(""), std::invalid_argument);
  EXPECT_THROW(SerialPort("/dev/ttyUSB0", 300), std::invalid_argument);
  EXPECT_THROW(SerialPort("/dev/ttyUSB0", 12'345), std::invalid_argument);
}

TEST_F(SerialPortTest, RetriesAfterAClockThatWasSetBack) {
  const std::string name = in_folder("board");
  SerialPort port(name);
  EXPECT_FALSE(port.poll(1000.0));
  const PseudoTerminal board(name);
  EXPECT_TRUE(port.poll(1.0));
}

TEST_F(SerialPortTest, LeavesAFileAloneThatStandsWhereTheLinkShouldBe) {
  std::ofstream(in_folder("file")) << "text";
  EXPECT_THROW(PseudoTerminal(in_folder("file")), std::invalid_argument);
  EXPECT_TRUE(fs::is_regular_file(in_folder("file")));
}

TEST_F(SerialPortTest, ReplacesAnOldLinkAndRemovesOnlyItsOwn) {
  const std::string name = in_folder("board");
  fs::create_symlink("/nowhere", name);
  {
    std::optional<PseudoTerminal> first(name);
    EXPECT_EQ(fs::read_symlink(name), first->slave_path());
    PseudoTerminal second(name);
    first.reset();
    EXPECT_EQ(fs::read_symlink(name), second.slave_path());
    EXPECT_EQ(second.path(), name);
  }
  EXPECT_FALSE(fs::is_symlink(name));
}

}  // namespace
}  // namespace secondskin::wire
