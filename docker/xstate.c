/* Lets a User-Mode Linux of 6.1 run on a processor whose register state is larger than its buffer (AMX: 11 kB, not 2.7). The host's
 * kernel takes a thread's extended registers whole or not at all (EFAULT), so here what the guest has replaces the front of all.
 * Loaded into linux.uml by LD_PRELOAD (uml.py). */

#define _GNU_SOURCE
#include <elf.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

long ptrace(enum __ptrace_request request, ...)
{
	static char whole[1 << 16] __attribute__((aligned(64))); /* the guest's kernel has one thread that traces */
	struct iovec all = {whole, sizeof(whole)}, *asked;
	va_list more;
	pid_t pid;
	void *addr, *data;
	long result, got;

	va_start(more, request);
	pid = va_arg(more, pid_t);
	addr = va_arg(more, void *);
	data = va_arg(more, void *);
	va_end(more);
	if ((request != PTRACE_GETREGSET && request != PTRACE_SETREGSET) || addr != (void *)NT_X86_XSTATE) {
		if (request < PTRACE_PEEKTEXT || request > PTRACE_PEEKUSER)
			return syscall(SYS_ptrace, request, pid, addr, data);
		result = syscall(SYS_ptrace, request, pid, addr, &got); /* the call's result is the word, as in libc */
		return result < 0 ? result : got;
	}
	asked = data;
	result = syscall(SYS_ptrace, PTRACE_GETREGSET, pid, addr, &all);
	if (result < 0)
		return result;
	if (asked->iov_len > all.iov_len)
		asked->iov_len = all.iov_len;
	if (request == PTRACE_GETREGSET) {
		memcpy(asked->iov_base, whole, asked->iov_len);
		return 0;
	}
	memcpy(whole, asked->iov_base, asked->iov_len);
	return syscall(SYS_ptrace, PTRACE_SETREGSET, pid, addr, &all);
}
